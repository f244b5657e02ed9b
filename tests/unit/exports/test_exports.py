"""Every format, read back by what reads it."""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from mavins import exports
from mavins.config import Config
from mavins.errors import ConfigError, LogFormatError
from mavins.estimates import Result
from mavins.exports import REGISTRY, TLOG, formats_of, write_exports
from mavins.exports.places import in_degrees
from mavins.filters.base import RowBlock
from mavins.nav.earth import dcm_ne
from mavins.nav.so3 import quat_to_dcm

# tables are written by compiled code, which takes long where nothing is compiled
pytestmark = pytest.mark.jit

Make = Callable[..., Result]
N, GAP_AT = 300, 200
GPX = "{http://www.topografix.com/GPX/1/1}"
KML = "{http://www.opengis.net/kml/2.2}"
GX = "{http://www.google.com/kml/ext/2.2}"
FIRST_TIME = "2026-09-21T14:13:30.000Z"


def written(result: Result, name: str, tmp_path: Path) -> list[Path]:
    folder = tmp_path / "exports"
    folder.mkdir(exist_ok=True)
    write_exports(result, [name], folder)
    assert sorted(path.name for path in folder.iterdir()) == sorted(REGISTRY[name].FILES)
    return [folder / file for file in REGISTRY[name].FILES]


def dcm(q_xyzw: Any) -> Any:
    return quat_to_dcm(np.ascontiguousarray(np.roll(q_xyzw, 1)))


def test_tum_is_the_trajectory_in_n(make_result: Make, tmp_path: Path) -> None:
    result = make_result()
    (path,) = written(result, "tum", tmp_path)
    rows = np.loadtxt(path)
    assert rows.shape == (N, 8)
    assert not path.read_text().startswith("\n")
    assert np.array_equal(np.round(rows[:, 0] * 1e6), result.t_us)
    assert np.allclose(rows[:, 1:4], result.p_n, atol=6e-5)
    C_ne = dcm_ne(math.radians(47.4), math.radians(8.5))
    for k in (0, 123, N - 1):
        lat, lon, _ = result.lla[k].tolist()
        C_lb = dcm(np.roll(result.quaternions[k], -1))
        C_nb = C_ne @ dcm_ne(lat, lon).T @ C_lb
        assert np.allclose(dcm(rows[k, 4:8]), C_nb, atol=1e-8)
        # 20 km from the origin the two frames are 3 mrad apart: they are not mistaken for each other
        assert not np.allclose(C_nb, C_lb, atol=1e-3)


def test_tum_wants_the_origin(make_result: Make, tmp_path: Path) -> None:
    with pytest.raises(LogFormatError, match="replay the log again"):
        written(make_result(origin=None), "tum", tmp_path)


def test_gpx(make_result: Make, tmp_path: Path) -> None:
    result = make_result()
    (path,) = written(result, "gpx", tmp_path)
    root = ElementTree.parse(path).getroot()
    assert root.tag == f"{GPX}gpx"
    assert root.get("version") == "1.1"
    estimate, gnss = root.findall(f"{GPX}trk")
    assert estimate.findtext(f"{GPX}name") == "estimate"
    assert gnss.findtext(f"{GPX}name") == "GNSS"
    before, after = estimate.findall(f"{GPX}trkseg")
    first = before.find(f"{GPX}trkpt")
    assert first is not None
    lat, lon, alt = in_degrees(result.lla)[0]
    assert float(first.get("lat", "")) == pytest.approx(lat, abs=1e-8)
    assert float(first.get("lon", "")) == pytest.approx(lon, abs=1e-8)
    assert float(first.findtext(f"{GPX}ele", "")) == pytest.approx(alt, abs=1e-3)
    assert first.findtext(f"{GPX}time") == FIRST_TIME
    assert (len(before), len(after)) == (8, 4)
    # the first fix was none
    assert len(gnss.findall(f".//{GPX}trkpt")) == 12


def test_gpx_without_utc_has_no_times(make_result: Make, tmp_path: Path) -> None:
    (path,) = written(make_result(utc_offset_us=None), "gpx", tmp_path)
    assert "<time>" not in path.read_text()
    assert len(ElementTree.parse(path).getroot().findall(f".//{GPX}trkpt")) == 24


def test_kml_plays_where_utc_is_known(make_result: Make, tmp_path: Path) -> None:
    result = make_result()
    (path,) = written(result, "kml", tmp_path)
    root = ElementTree.parse(path).getroot()
    tracks = root.findall(f".//{GX}Track")
    assert len(tracks) == 3
    assert {track.findtext(f"{KML}altitudeMode") for track in tracks} == {"absolute"}
    times, places = tracks[0].findall(f"{KML}when"), tracks[0].findall(f"{GX}coord")
    assert len(times) == len(places) == 8
    assert times[0].text == FIRST_TIME
    expected = in_degrees(result.lla)[0, [1, 0, 2]]
    assert [float(n) for n in str(places[0].text).split()] == pytest.approx(expected, abs=1e-3)
    styles = {f"#{style.get('id')}" for style in root.findall(f".//{KML}Style")}
    assert {url.text for url in root.findall(f".//{KML}styleUrl")} <= styles


def test_kml_is_a_line_where_it_is_not(make_result: Make, tmp_path: Path) -> None:
    (path,) = written(make_result(utc_offset_us=None), "kml", tmp_path)
    root = ElementTree.parse(path).getroot()
    assert not root.findall(f".//{GX}Track")
    line = root.find(f".//{KML}LineString")
    assert line is not None
    assert line.findtext(f"{KML}altitudeMode") == "absolute"
    assert len(line.findtext(f"{KML}coordinates", "").split()) == 8


def test_a_result_without_estimates(make_result: Make, tmp_path: Path) -> None:
    result = make_result(block=RowBlock.empty(1, Config().states.layout().size))
    for name in REGISTRY:
        for path in written_into(result, name, tmp_path):
            assert path.exists()


def written_into(result: Result, name: str, folder: Path) -> list[Path]:
    if not exports.is_installed(name):
        pytest.skip(f"what {name} needs is not installed")
    write_exports(result, [name], folder)
    return [folder / file for file in REGISTRY[name].FILES]


def test_parquet_holds_what_the_csv_files_hold(make_result: Make, tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    result = make_result()
    for path in written(result, "parquet", tmp_path):
        table = pq.read_table(path)
        with (tmp_path / "result" / "eskf" / path.name).with_suffix(".csv").open() as file:
            header, *rows = csv.reader(file)
        assert table.column_names == header
        columns = table.to_pydict()
        assert len(rows) == table.num_rows > 0
        for name, texts in zip(header, zip(*rows, strict=True), strict=True):
            values = columns[name]
            if name in ("aiding", "source", "reason"):
                assert values == list(texts)
            elif name == "accepted":
                assert values == [text == "1" for text in texts]
            else:
                assert values == [float(text) if text else None for text in texts]


def messages_of(path: Path) -> list[tuple[Any, Any, Any]]:
    """(schema, channel, message), read by the format's own reader."""
    reader = pytest.importorskip("mcap.reader")
    with path.open("rb") as file:
        return list(reader.make_reader(file, validate_crcs=True).iter_messages())


def decoded(schema: Any, data: bytes) -> Any:
    """A message by the schema that the file itself brings along."""
    descriptor_pb2 = pytest.importorskip("google.protobuf.descriptor_pb2")
    from google.protobuf import descriptor_pool, message_factory

    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))()
    message.ParseFromString(data)
    return message


def test_mcap_has_foxglove_s_schemas(make_result: Make, tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    from foxglove import messages as m

    (path,) = written(make_result(), "mcap", tmp_path)
    found = messages_of(path)
    topics = {channel.topic: schema for schema, channel, _ in found}
    expected = {
        "/estimate/pose": m.PoseInFrame,
        "/estimate/odometry": m.Odometry,
        "/estimate/location": m.LocationFix,
        "/gnss/location": m.LocationFix,
        "/tf": m.FrameTransform,
        "/log": m.Log,
    }
    assert set(topics) == {*expected, "/innovations/gnss_velocity"}
    for topic, kind in expected.items():
        own = kind.get_schema()
        assert (topics[topic].name, topics[topic].encoding) == (own.name, own.encoding)
        assert topics[topic].data == own.data
    counts = Counter(channel.topic for _, channel, _ in found)
    assert counts["/estimate/pose"] == N
    assert counts["/estimate/odometry"] == counts["/estimate/location"] == 60
    assert counts["/gnss/location"] == 29
    assert counts["/tf"] == 61


def test_mcap_tells_what_the_result_tells(make_result: Make, tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    result = make_result()
    (path,) = written(result, "mcap", tmp_path)
    found = messages_of(path)
    e, offset_us = result, result.summary["utc_offset_us"]
    assert min(message.log_time for _, _, message in found) == (int(e.t_us[0]) + offset_us) * 1000
    by_topic: dict[str, list[Any]] = {}
    for schema, channel, message in found:
        if schema.encoding == "protobuf":
            by_topic.setdefault(channel.topic, []).append(decoded(schema, message.data))
            stamp = by_topic[channel.topic][-1].timestamp
            assert stamp.seconds * 1_000_000_000 + stamp.nanos == message.log_time
    last = by_topic["/estimate/pose"][-1]
    place = last.pose.position
    assert [place.x, place.y, place.z] == e.p_n[-1].tolist()
    odometry = by_topic["/estimate/odometry"][0]
    assert (odometry.frame_id, odometry.body_frame_id) == ("n", "body")
    q = odometry.pose.orientation
    v, lat, lon = odometry.linear_velocity, *e.lla[0, :2].tolist()
    C_ln = dcm_ne(lat, lon) @ dcm_ne(math.radians(47.4), math.radians(8.5)).T
    v_l = C_ln @ dcm(np.array([q.x, q.y, q.z, q.w])) @ np.array([v.x, v.y, v.z])
    assert np.allclose(v_l, e.v[0], atol=1e-7)
    assert odometry.pose_covariance[0] == pytest.approx(0.04)
    assert odometry.velocity_covariance[7] == pytest.approx(0.04, rel=1e-5)
    location = by_topic["/estimate/location"][0]
    assert [location.latitude, location.altitude] == in_degrees(e.lla)[0, [0, 2]].tolist()
    fix = by_topic["/gnss/location"][0]
    assert list(fix.position_covariance)[::4] == pytest.approx([0.25, 0.25, 0.64])
    root, *moving = by_topic["/tf"]
    assert (root.parent_frame_id, root.child_frame_id) == ("map", "n")
    # north in n is the second axis of the map, and down is the third one backwards
    turn = dcm(np.array([getattr(root.rotation, axis) for axis in "xyzw"]))
    assert np.allclose(turn, [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=1e-12)
    assert {(m.parent_frame_id, m.child_frame_id) for m in moving} == {("n", "body")}
    warning, end = by_topic["/log"]
    assert (warning.message, end.message) == ("gnss_velocity: gate", "running")
    assert (warning.level, end.level) == (3, 2)


def test_innovations_in_mcap_follow_their_schema(make_result: Make, tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    (path,) = written(make_result(), "mcap", tmp_path)
    found = [
        (schema, message)
        for schema, channel, message in messages_of(path)
        if channel.topic == "/innovations/gnss_velocity"
    ]
    schema = json.loads(found[0][0].data)
    assert found[0][0].encoding == "jsonschema"
    said = [json.loads(message.data) for _, message in found]
    assert all(set(one) == set(schema["properties"]) for one in said)
    assert [one["accepted"] for one in said] == [True, True, True, False, True]
    assert said[3]["reason"] == "gate"
    assert said[3]["nis"] == 40.0
    assert said[2]["innovation"] == [0.2, -0.2]
    assert said[2]["sigma"] == [0.3, 0.4]


@pytest.mark.parametrize("name", sorted(REGISTRY))
def test_a_full_disk_is_an_error(
    name: str, make_result: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each format says that it could not be written; none is left out quietly."""
    if not exports.is_installed(name):
        pytest.skip(f"what {name} needs is not installed")
    result = make_result()
    full = tmp_path / "full"
    full.mkdir()
    for file in REGISTRY[name].FILES:
        (full / file).symlink_to("/dev/full")
    with pytest.raises(OSError, match=r"[Nn]o space left"):
        write_exports(result, [name], full)


def test_formats(monkeypatch: pytest.MonkeyPatch) -> None:
    known = (*REGISTRY, TLOG)
    assert formats_of("none", known) == ()
    assert formats_of("kml,tum,kml", known) == ("kml", "tum")
    assert formats_of("tlog", known) == ("tlog",)
    with pytest.raises(ConfigError, match=r"no format 'shp'; there are: tum, kml, gpx, parquet"):
        formats_of("shp", known)
    monkeypatch.setattr(exports, "find_spec", lambda name: None)
    assert formats_of("usual", known) == ("tum", "kml", "gpx")
    with pytest.raises(ModuleNotFoundError) as caught:
        formats_of("kml,parquet", known)
    assert caught.value.name == "pyarrow"
