"""A result folder as a page that a person looks at; needs the extra `report`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from mavins.estimates import Result
from mavins.evaluation.findings import findings
from mavins.evaluation.result_folder import read_result
from mavins.report.drawing import Figure
from mavins.report.figures import of_estimate
from mavins.report.figures_innovations import of_innovations
from mavins.report.figures_sensors import of_sensors
from mavins.results import REPORT, write_text

PNGS: Final = "figures"


def sections_of(result: Result) -> list[tuple[str, list[Figure]]]:
    """The figures that have something to show, by the page's sections."""
    groups = (
        ("Estimate", of_estimate(result)),
        ("Innovations", of_innovations(result)),
        ("Sensors", of_sensors(result)),
    )
    return [
        (title, [shown for figure in figures if (shown := figure.filled()) is not None])
        for title, figures in groups
    ]


def write_report(folder: Path, png: bool = False) -> list[Path]:
    """Write the report of a result folder, and with `png` its figures as files; returns what was written.

    Raises LogFormatError for what is no result folder, OutputError where nothing can be written.
    """
    return write_report_of(read_result(folder), folder, png)


def write_report_of(result: Result, folder: Path, png: bool = False) -> list[Path]:
    """The same of a result at hand, into a folder."""
    from mavins.report.page import page_of

    sections = sections_of(result)
    written = [folder / REPORT]
    name = str(result.summary.get("log") or folder)
    write_text(written[0], page_of(name, result, findings(result), sections))
    if png:
        from mavins.report.pngs import write_png

        (folder / PNGS).mkdir(exist_ok=True)
        for _, figures in sections:
            for figure in figures:
                written.append(folder / PNGS / f"{figure.key}.png")
                write_png(written[-1], figure)
    return written
