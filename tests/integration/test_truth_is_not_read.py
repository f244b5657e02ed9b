"""No estimator reads a simulator's truth: neither does its code name it, nor do its estimates change with it."""

from __future__ import annotations

import ast
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

HIL_STATE_QUATERNION, SIM_STATE, LOCAL_POSITION_NED, ODOMETRY = 115, 108, 32, 331
BLIND = (
    "mavins.nav",
    "mavins.aiding",
    "mavins.filters",
    "mavins.estimator",
    "mavins.mavlink.intake",
    "mavins.mavlink.clock",
    "mavins.mavlink.sources",
    "mavins.mavlink.session",
    "mavins.mavlink.vehicle",
    "mavins.mavlink.streams",
    "mavins.mavlink.requests",
)
"""Modules and packages between a packet and an estimate."""
FORBIDDEN = (
    "hil_state",
    "hilstate",
    "sim_state",
    "simstate",
    "decode_truth",
    "truth",
    "evaluation",
)


def sources(name: str) -> list[Path]:
    spec = importlib.util.find_spec(name)
    assert spec is not None
    assert spec.origin is not None
    path = Path(spec.origin)
    return sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]


def names_in(tree: ast.AST) -> set[str]:
    """All names, attributes, imports, arguments and strings of a module, its docstrings aside."""
    documents = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            found.add(node.id)
        elif isinstance(node, ast.Attribute):
            found.add(node.attr)
        elif isinstance(node, ast.arg):
            found.add(node.arg)
        elif isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            found.update([node.module or "", *(alias.name for alias in node.names)])
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in documents
        ):
            found.add(node.value)
    return found


@pytest.mark.parametrize("module", BLIND)
def test_the_code_does_not_name_it(module: str) -> None:
    for path in sources(module):
        for name in names_in(ast.parse(path.read_text(encoding="utf-8"))):
            for word in FORBIDDEN:
                assert word not in name.lower(), f"{path.name} names {name}"


def test_the_codec_keeps_truth_apart() -> None:
    from mavins.mavlink.codec import fields_of, scan
    from mavins.mavlink.codec.decode import _DECODERS, decode
    from mavins.mavlink.intake import RELEVANT

    for name in ("HIL_STATE_QUATERNION", "SIM_STATE"):
        msgid = fields_of(name).msgid
        assert msgid not in _DECODERS
        assert msgid not in RELEVANT
    from mavins.mavlink.codec import frame, hil_state_quaternion
    from mavins.types import TruthSample

    sample = TruthSample(1, 0.8, 0.1, 400.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    packet = frame(hil_state_quaternion(sample, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 1, 1, 0)
    frames = scan(packet)
    assert len(frames) == 1
    assert decode(frames, 0) is None


def msgid(packet: bytes) -> int:
    return int.from_bytes(packet[7:10], "little")


def without_truth(stream: list[Any]) -> list[Any]:
    return [item for item in stream if msgid(item[2]) != HIL_STATE_QUATERNION]


def with_false_truth(stream: list[Any]) -> list[Any]:
    """Another flight's truth in place of its own, and a second truth message that is wrong."""
    from pymavlink.dialects.v20 import all as dialect

    from sitl import scenario
    from sitl.emitter import packets
    from sitl.simulation import Simulation

    other = packets(Simulation(scenario.load("figure8"), 9))
    lies = (packet for _, packet in other if msgid(packet) == HIL_STATE_QUATERNION)
    changed = []
    for now_us, address, data in stream:
        if msgid(data) == HIL_STATE_QUATERNION:
            sim_state = dialect.MAVLink_sim_state_message(*[1.0] * 21)
            changed.append((now_us, address, sim_state.pack(dialect.MAVLink(None, 1, 1))))
            data = next(lies)
        changed.append((now_us, address, data))
    return changed


@pytest.mark.jit
@pytest.mark.parametrize("change", [without_truth, with_false_truth])
def test_estimates_do_not_change_with_it(
    change: Callable[[list[Any]], list[Any]], make_rig: Callable[..., Any], fly: Any
) -> None:
    stream = fly(9.0)
    told, changed = make_rig(name="told"), make_rig(name="changed")
    told.run(stream).close()
    changed.run(change(stream)).close()
    for name in ("estimates.csv", "innovations.csv"):
        expected = (told.folder() / name).read_bytes()
        assert expected.count(b"\n") > 100
        assert (changed.folder() / name).read_bytes() == expected

    # and what is sent is the same too
    def bodies(rig: Any) -> list[Any]:
        return [m.to_dict() for _, _, m in rig.sent]

    assert bodies(told) == bodies(changed)


@pytest.mark.jit
def test_other_estimates_of_the_vehicle_are_not_read_either(
    make_rig: Callable[..., Any], fly: Any
) -> None:
    """An autopilot's own LOCAL_POSITION_NED, ODOMETRY and quaternion are its filter's output, not measurements."""
    from pymavlink.dialects.v20 import all as dialect

    link = dialect.MAVLink(None, 1, 1)
    stream = fly(9.0)
    more = []
    for now_us, address, data in stream:
        more.append((now_us, address, data))
        if msgid(data) == 30:
            wrong = (
                dialect.MAVLink_local_position_ned_message(5, 1e3, 2e3, 3e3, 4.0, 5.0, 6.0),
                dialect.MAVLink_attitude_quaternion_message(5, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0),
                dialect.MAVLink_global_position_int_cov_message(
                    7, 1, 470000000, 80000000, 5, 5, 1.0, 1.0, 1.0, [0.0] * 36
                ),
            )
            more += [(now_us, address, bytes(m.pack(link))) for m in wrong]
    plain, loud = make_rig(name="plain"), make_rig(name="loud")
    plain.run(stream).close()
    loud.run(more).close()
    expected = (plain.folder() / "estimates.csv").read_bytes()
    assert (loud.folder() / "estimates.csv").read_bytes() == expected
