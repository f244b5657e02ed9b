"""The documentation against the code: links, paths, names, tables, and the tutorial's commands."""

from __future__ import annotations

import argparse
import csv
import dataclasses
import importlib
import os
import re
import runpy
import select
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import mavins
import sitl
from mavins import aiding, config, filters, results
from mavins.cli.main import COMMANDS
from mavins.mavlink import commands
from mavins.mavlink.settings import StreamSettings

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"mavins": Path(mavins.__file__).parent, "sitl": Path(sitl.__file__).parent}
WHOLE = (ROOT / "Makefile").exists()
"""False where only tests and docs were copied beside an installed package."""
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TUTORIAL = ROOT / "docs" / "tutorials" / "first-flight.md"
WITHOUT_THEORY = {"__init__", "base", "kernels", "many", "settings", "walking"}

_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
_CODE = re.compile(r"`([^`\n]+)`")
_PATH = re.compile(r"(?<![\w/.-])(?:mavins|sitl|docs|tests)/[\w./-]*")


def page_id(page: Path) -> str:
    return str(page.relative_to(ROOT))


def without_blocks(text: str) -> str:
    """A page's text without its fenced blocks."""
    return re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)


def located(path: str) -> Path:
    """Where a path of the repository lies: the packages may be installed elsewhere."""
    first, _, rest = path.partition("/")
    return PACKAGES[first] / rest if first in PACKAGES else ROOT / path


def anchor(heading: str) -> str:
    """The anchor that a heading gets."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_internal_links_lead_somewhere(page: Path) -> None:
    for link in _LINK.findall(without_blocks(page.read_text(encoding="utf-8"))):
        target, _, fragment = link.partition("#")
        if "://" in target or (not WHOLE and target in ("LICENSE", "CHANGELOG.md")):
            continue
        path = (page.parent / target).resolve() if target else page
        assert path.exists(), f"{page.name} links to {link}"
        if fragment:
            headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
            assert fragment in map(anchor, headings), f"{page.name} links to {link}"


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_paths_in_the_docs_exist(page: Path) -> None:
    for code in _CODE.findall(without_blocks(page.read_text(encoding="utf-8"))):
        for path in _PATH.findall(code):
            assert located(path).exists(), f"{page.name} names {path}"


def sources() -> Iterator[Path]:
    for folder in PACKAGES.values():
        yield from sorted(folder.rglob("*.py"))


def test_theory_pages_that_docstrings_name_exist() -> None:
    named = [
        (source.name, page)
        for source in sources()
        for page in re.findall(r"docs/[\w/]+\.md", source.read_text(encoding="utf-8"))
    ]
    assert named
    missing = [(source, page) for source, page in named if not (ROOT / page).exists()]
    assert missing == []


@pytest.mark.parametrize("room", ["nav", "aiding", "filters"])
def test_every_module_of_the_mathematics_names_its_theory_page(room: str) -> None:
    for source in sorted((PACKAGES["mavins"] / room).glob("*.py")):
        if source.stem in WITHOUT_THEORY:
            continue
        text = source.read_text(encoding="utf-8")
        found = re.search(r"Theory: (docs/theory/\w+\.md)", text)
        assert found, f"{source.name} names no theory page"
        page = (ROOT / found.group(1)).read_text(encoding="utf-8")
        assert f"mavins/{room}/{source.name}" in page, f"{found.group(1)} does not name its code"


def modules() -> dict[str, list[str]]:
    """Module name without its package -> full names."""
    table: dict[str, list[str]] = {}
    folder = PACKAGES["mavins"]
    for source in folder.rglob("*.py"):
        dotted = ".".join(("mavins", *source.relative_to(folder).with_suffix("").parts))
        table.setdefault(source.stem, []).append(dotted)
    return table


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "theory").glob("*.md")), ids=page_id)
def test_functions_that_equations_name_exist(page: Path) -> None:
    known = modules()
    settings = {field.name for field in dataclasses.fields(config.Config)}
    for code in _CODE.findall(page.read_text(encoding="utf-8")):
        match = re.fullmatch(r"([a-z_0-9]+)\.([A-Za-z_]+)", code)
        if not match or match.group(2) in ("py", "csv", "json", "md", "yaml"):
            continue
        module, name = match.groups()
        if module in settings and hasattr(getattr(config.Config(), module), name):
            continue
        candidates = [importlib.import_module(full) for full in known.get(module, [])]
        assert any(hasattr(m, name) for m in candidates), f"{page.name} names {code}"


def test_every_registered_aiding_and_filter_has_a_page() -> None:
    pages = "".join(p.read_text(encoding="utf-8") for p in (ROOT / "docs" / "theory").glob("*.md"))
    for entry in (*aiding.REGISTRY.values(), *filters.REGISTRY.values()):
        module = entry.partition(":")[0]
        assert f"{module.replace('.', '/')}.py" in pages


def test_the_configuration_page_is_in_step() -> None:
    page = (ROOT / "docs" / "reference" / "configuration.md").read_text(encoding="utf-8")
    settings = config.default_yaml().partition("\n")[2].strip()
    assert page.endswith(f"```yaml\n{settings}\n```\n"), (
        "run: python docs/reference/make_configuration.py"
    )


def test_the_parameter_page_is_in_step() -> None:
    folder = ROOT / "docs" / "reference"
    maker = runpy.run_path(str(folder / "make_parameters.py"))
    assert (folder / "parameters.md").read_text(encoding="utf-8") == maker["page"](), (
        "run: python docs/reference/make_parameters.py"
    )


def names_of(module: str) -> set[str]:
    """Everything that modules of this short name define."""
    return {
        name for full in modules().get(module, []) for name in dir(importlib.import_module(full))
    }


def test_settings_that_the_docs_name_exist() -> None:
    defaults = config.Config()
    sections = [field.name for field in dataclasses.fields(config.Config)]
    pattern = re.compile(rf"(?<![\w/])({'|'.join(sections)})\.([a-z_]+)(?=:|$)")
    for page in PAGES:
        for code in _CODE.findall(without_blocks(page.read_text(encoding="utf-8"))):
            for section, key in pattern.findall(code):
                known = hasattr(getattr(defaults, section), key) or key in names_of(section)
                assert known or key in ("py", "csv"), f"{page.name} names {code}"


def test_the_columns_of_the_results_page() -> None:
    page = (ROOT / "docs" / "reference" / "results.md").read_text(encoding="utf-8")
    estimates = page.split("## estimates.csv")[1].split("## innovations.csv")[0]
    innovations = page.split("## innovations.csv")[1].split("## summary.json")[0]
    first_cells = re.compile(r"^\| (`[^|]*) \|", re.MULTILINE)
    named = [c for cell in first_cells.findall(estimates) for c in _CODE.findall(cell)]
    assert named == results.ESTIMATES.split(",")
    named = [c for cell in first_cells.findall(innovations) for c in _CODE.findall(cell)]
    wanted = [c for c in results.INNOVATIONS.split(",") if not c.endswith("_1")]
    assert named == wanted


def test_the_rates_of_the_messages_page() -> None:
    page = (ROOT / "docs" / "reference" / "messages.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| [A-Z_]+ \| ([\d.]+) \| ([\d.]+) \| `streams\.(\w+)`", page, re.MULTILINE
    )
    told = {name: (float(vehicle), float(companion)) for vehicle, companion, name in rows}
    usual = StreamSettings()
    vehicle, companion = usual.rates("vehicle"), usual.rates("companion")
    assert told == {name: (vehicle[name], companion[name]) for name in vehicle}


def test_the_commands_of_the_messages_page() -> None:
    page = (ROOT / "docs" / "reference" / "messages.md").read_text(encoding="utf-8")
    block = page.split("| command | what it does |")[1].split("What was carried out")[0]
    rows = re.findall(r"^\| [A-Z_]+ (\d+)( \(changes state\))? \|", block, re.MULTILINE)
    assert {int(number) for number, _ in rows} == set(commands.HANDLERS)
    assert {int(n) for n, changes in rows if changes} == set(commands.HANDLERS) & commands.CHANGING


def console_lines(text: str) -> list[str]:
    """The commands of all console blocks."""
    blocks = re.findall(r"^```console\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return [line[2:] for block in blocks for line in block.splitlines() if line.startswith("$ ")]


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_commands_of_the_docs_have_their_options(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    commands = console_lines(text) + [c for c in _CODE.findall(text) if c.startswith("mavins ")]
    for line in commands:
        words = shlex.split(line, comments=True)
        if words[:1] != ["mavins"] or len(words) < 2 or words[1].startswith("-"):
            continue
        name = words[1]
        assert name in COMMANDS, f"{page.name}: {line}"
        parser = argparse.ArgumentParser(add_help=False)
        importlib.import_module(COMMANDS[name][0]).add_arguments(parser)
        known = {option for action in parser._actions for option in action.option_strings}
        used = {word for word in words[2:] if word.startswith("--")}
        assert used <= known | {"--help"}, f"{page.name}: {line}"


# ---- the tutorial, run ---------------------------------------------------------------------------------------------


def steps() -> list[tuple[str, list[str]]]:
    """(marker, commands) of the blocks that are marked: run, start (in the background), stop."""
    found = re.findall(
        r"<!-- (run|start|stop) -->\n```console\n(.*?)```", TUTORIAL.read_text("utf-8"), re.DOTALL
    )
    return [
        (kind, [line[2:] for line in block.splitlines() if line.startswith("$ ")])
        for kind, block in found
    ]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def wait_for(process: subprocess.Popen[str], beginning: str, limit: float) -> None:
    """Read lines until one begins so."""
    assert process.stdout is not None
    deadline = time.monotonic() + limit
    while (left := deadline - time.monotonic()) > 0:
        if select.select([process.stdout], [], [], left)[0]:
            line = process.stdout.readline()
            if line.startswith(beginning):
                return
            assert line, f"ended with exit status {process.wait()}"
    raise AssertionError(f"no line that begins with '{beginning}' within {limit:.0f} s")


def test_the_tutorial_runs(tmp_path: Path) -> None:
    port = str(free_port())
    program = tmp_path / "bin" / "mavins"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m mavins "$@"\n')
    program.chmod(0o755)
    env = {**os.environ, "PATH": f"{program.parent}{os.pathsep}{os.environ['PATH']}"}
    paths = [str(PACKAGES["mavins"].parent), os.environ.get("PYTHONPATH", "")]
    env["PYTHONPATH"] = os.pathsep.join(p for p in paths if p)

    def ready(command: str) -> str:
        """The command as the test runs it: a free port on this host, and a short flight."""
        command = command.replace("--udp 14550", f"--udp 127.0.0.1:{port}")
        command = command.replace("127.0.0.1:14550", f"127.0.0.1:{port}")
        return re.sub(r"--duration \d+", "--duration 9", command)

    background: subprocess.Popen[str] | None = None
    kinds = []
    try:
        for kind, commands in steps():
            kinds.append(kind)
            if kind == "start":
                (command,) = commands
                background = subprocess.Popen(
                    shlex.split(ready(command)),
                    cwd=tmp_path,
                    env=env,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    text=True,
                )
                wait_for(background, "listening udp", 120.0)
            elif kind == "stop":
                assert background is not None
                background.send_signal(signal.SIGINT)
                background.communicate(timeout=30.0)
                assert background.returncode == 0
            else:
                for command in commands:
                    done = subprocess.run(
                        ready(command),
                        shell=True,
                        cwd=tmp_path,
                        env=env,
                        stdin=subprocess.DEVNULL,
                        capture_output=True,
                        text=True,
                        timeout=150.0,
                    )
                    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    finally:
        if background is not None and background.poll() is None:
            background.kill()
            background.communicate()
    assert kinds.count("start") == kinds.count("stop") == 1
    with (tmp_path / "result" / "eskf" / "estimates.csv").open(encoding="ascii") as file:
        rows = list(csv.reader(file))
    assert ",".join(rows[0]) == f"{results.ESTIMATES},{results.EXTRA['tau']}"
    assert len(rows) > 100
