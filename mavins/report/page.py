"""The report as one self-contained page: header, findings, figures."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import Any, Final

from plotly.offline import get_plotlyjs

from mavins.estimates import Result
from mavins.evaluation.findings import Finding
from mavins.report.drawing import Figure
from mavins.report.plotly_figures import height, plotly_figure

_COLUMNS: Final = (
    ("pos_m", "position, m", ("north", "east", "down")),
    ("vel_m_s", "velocity, m/s", ("north", "east", "down")),
    ("att_deg", "attitude, deg", ("roll", "pitch", "yaw")),
)
_JUDGED: Final = (
    ("truth", "Error against"),
    ("reference", "Difference to"),
    ("smoothed", "Smoothed"),
)


def page_of(
    name: str,
    result: Result,
    findings: Sequence[Finding],
    sections: Sequence[tuple[str, Sequence[Figure]]],
) -> str:
    """The HTML text of a log's result."""
    figures = [figure for _, group in sections for figure in group]
    extent = _extent(figures)
    drawn = [plotly_figure(figure, extent) for figure in figures]
    keys = {figure.key for figure in figures}
    template = Template((files("mavins.report") / "page.html").read_text(encoding="utf-8"))
    return template.substitute(
        title=escape(f"{_last(name)} - mavins report"),
        heading=escape(_last(name)),
        facts=" · ".join(_facts(result)),
        errors=_errors(result.summary),
        findings="\n".join(_finding(finding, keys) for finding in findings),
        links=_links(sections),
        sections="\n".join(_sections(sections)),
        plotly=get_plotlyjs(),
        figures=json.dumps(drawn, separators=(",", ":")).replace("</", "<\\/"),
    )


def _last(name: str) -> str:
    return name.rstrip("/").rpartition("/")[2] or name


def _extent(figures: Sequence[Figure]) -> tuple[float, float] | None:
    """What the time axes show at first: from the first to the last of what is drawn over time."""
    ends = [
        (float(series.x[0]), float(series.x[-1]))
        for figure in figures
        if figure.kind == "time"
        for panel in figure.panels
        for series in panel.series
        if len(series.x)
    ]
    if not ends:
        return None
    first, last = min(end[0] for end in ends), max(end[1] for end in ends)
    return (first, last) if last > first else None


def _facts(result: Result) -> Iterator[str]:
    summary = result.summary
    yield f"mavins {escape(str(summary.get('mavins', '')))}"
    yield f"filter {escape(result.filter)}"
    if summary.get("sysid") is not None:
        yield f"vehicle {int(summary['sysid'])}"
    seconds = float(summary.get("log_s") or _duration(result))
    yield f"{int(seconds // 60)} min {seconds % 60:.0f} s"
    imu = summary.get("imu") or {}
    if imu.get("message"):
        yield f"IMU {escape(str(imu['message']))}, {int(summary.get('imu_samples', 0))} samples"
    yield f"{int(summary.get('rows', len(result)))} estimates"


def _duration(result: Result) -> float:
    return float(result.t_us[-1] - result.t_us[0]) * 1e-6 if len(result) else 0.0


def _errors(summary: Mapping[str, Any]) -> str:
    """The table of errors: what is compared, RMS and largest."""
    rows, said = [], ""
    for key, words in _JUDGED:
        judged = summary.get(key) or {}
        for name, label, axes in _COLUMNS:
            if name not in (judged.get("rms") or {}):
                continue
            source = escape(f"{words} {judged.get('source', '')}".strip())
            source, said = ("" if source == said else source), source
            cells = "".join(
                f"<td>{float(value):.3f}</td>"
                for kind in ("rms", "max")
                for value in judged[kind][name]
            )
            rows.append(f"<tr><th>{source}</th><th>{label} ({'/'.join(axes)})</th>{cells}</tr>")
    if not rows:
        return ""
    head = '<tr><th></th><th></th><td colspan="3">RMS</td><td colspan="3">largest</td></tr>'
    return f"<table>{head}{''.join(rows)}</table>"


def _finding(finding: Finding, keys: set[str]) -> str:
    css = "note-level" if finding.level == "note" else finding.level
    text = escape(finding.text)
    if finding.figure in keys:
        text += f' <a href="#{finding.figure}">figure</a>'
    advice = f'<span class="advice">{escape(finding.advice)}</span>' if finding.advice else ""
    return f'<li class="{css}"><span class="tag">{finding.level}</span><span>{text}{advice}</span></li>'


def _links(sections: Sequence[tuple[str, Sequence[Figure]]]) -> str:
    return "\n".join(
        f'<a href="#{figure.key}">{escape(figure.title.partition(":")[0])}</a>'
        for _, group in sections
        for figure in group
    )


def _sections(sections: Sequence[tuple[str, Sequence[Figure]]]) -> Iterator[str]:
    for title, group in sections:
        if group:
            yield f"<h2>{escape(title)}</h2>"
        for figure in group:
            yield f'<h3 id="{figure.key}">{escape(figure.title)}</h3>'
            if figure.note:
                yield f'<p class="note">{escape(figure.note)}</p>'
            yield f'<div class="plot" id="plot-{figure.key}" style="height:{height(figure)}px"></div>'
