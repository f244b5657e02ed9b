"""A scenario is checked strictly, and what is wrong is named by its path."""

import copy
import dataclasses

import pytest
import yaml

from mavins.errors import ScenarioError
from sitl import scenario
from sitl.imu import TriadSettings

SMALL = {
    "origin": {"lat_deg": 1, "lon_deg": 2, "alt": 3},
    "motion": {"kind": "plan", "segments": [{"do": "hover", "seconds": 3}]},
}


def with_value(path, value):
    data = copy.deepcopy(SMALL)
    *folders, key = path
    place = data
    for folder in folders:
        place = place.setdefault(folder, {}) if isinstance(place, dict) else place[folder]
    place[key] = value
    return data


def test_a_small_scenario_takes_all_else_from_the_defaults():
    parsed = scenario.parse(SMALL)
    assert parsed.imu.rate == 250
    assert parsed.gnss.rate == 5
    assert parsed.trajectory().period >= 9.0


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("wind",), 1, "unknown key wind, allowed: origin, motion, description, imu, gnss"),
        (("imu", "gyro", "nois"), 1, "unknown key imu.gyro.nois, allowed: noise, bias, bias_walk"),
        (
            ("gnss", "markov_position", "tau"),
            1,
            "unknown key gnss.markov_position.tau, allowed: si",
        ),
        (("imu", "gyro", "noise"), -1, "imu.gyro.noise: should be greater than or equal to 0, not"),
        (("imu", "accel", "noise"), "low", "imu.accel.noise: should be a valid number, not 'low'"),
        (("imu", "integrate"), 1, "imu.integrate: should be a valid boolean, not 1"),
        (("imu", "rate"), 300, "imu.rate: must divide 1000"),
        (("imu",), 3, "imu: should be an object, not 3"),
        (("gnss", "lever_arm"), [1, 2], r"missing key gnss.lever_arm\[2\]"),
        (("gnss", "outages"), [[1, 2], [3]], r"missing key gnss.outages\[1\]\[1\]"),
        (("gnss", "sigma_h"), float("nan"), "gnss.sigma_h: should be"),
        (("origin", "lat_deg"), 91, "origin.lat_deg: should be less than or equal to 90, not 91"),
        (("motion",), {"file": "x"}, "motion.kind: must be one of 'plan', 'track'"),
        (("motion", "kind"), "walk", "motion.kind: must be one of 'plan', 'track'"),
        (("motion", "segments"), [], "motion.segments: "),
        (
            ("motion", "segments", 0),
            {"do": "fly"},
            r"motion.segments\[0\].do: must be one of 'hover'",
        ),
        (
            ("motion", "segments", 0),
            {"do": "go", "north": 1, "east": 0, "sped": 3},
            r"unknown key motion.segments\[0\].sped, allowed: do, north, east, height",
        ),
        (("motion", "segments", 0), {"do": "turn", "by_deg": 90}, "must end where and as it began"),
        (("motion",), {"kind": "track", "file": "none.csv"}, "cannot read the track"),
    ],
)
def test_what_is_wrong_is_named_by_its_path(path, value, message):
    with pytest.raises(ScenarioError, match=message):
        scenario.parse(with_value(path, value))


def test_a_missing_key_is_named():
    with pytest.raises(ScenarioError, match="missing key origin"):
        scenario.parse({"motion": SMALL["motion"]})
    for nonsense in (None, [1], "hover"):
        with pytest.raises(ScenarioError, match="scenario: should be an object"):
            scenario.parse(nonsense)


def test_a_file_of_one_s_own(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(SMALL))
    assert scenario.load(str(path)) == scenario.parse(SMALL)
    path.write_text(yaml.safe_dump(with_value(("imu", "x"), 1)))
    with pytest.raises(ScenarioError, match=r"mine.yaml: unknown key imu.x, allowed: rate"):
        scenario.load(str(path))
    path.write_text("origin: [")
    with pytest.raises(ScenarioError, match=r"cannot read the scenario .*mine.yaml"):
        scenario.load(str(path))
    with pytest.raises(ScenarioError, match="cannot read the scenario"):
        scenario.load(str(tmp_path / "none.yaml"))


def test_a_track_lies_beside_its_scenario(tmp_path):
    rows = "\n".join(f"{0.5 * k},{9.0 * k},0,100,0,0,0" for k in range(40))
    (tmp_path / "line.csv").write_text("time_s,n,e,h,r,p,y\n" + rows)
    motion = {"kind": "track", "file": "line.csv", "run_up": 10, "come_back": 40}
    (tmp_path / "line.yaml").write_text(yaml.safe_dump({**SMALL, "motion": motion}))
    trajectory = scenario.load(str(tmp_path / "line.yaml")).trajectory()
    assert trajectory.period > 70.0
    (tmp_path / "point.csv").write_text("time_s,n,e,h,r,p,y\n0,1,2,3,4,5,6\n")
    with pytest.raises(ScenarioError, match="must have rows of time_s"):
        scenario.parse({**SMALL, "motion": {**motion, "file": "point.csv"}}, tmp_path)


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(ScenarioError, match="figure8, gnss_outage, hover, quad_mission, square_sp"):
        scenario.load("loop")


def test_the_issue_s_noises():
    for name in ("quad_mission", "square_spiral", "hover"):
        gnss = scenario.load(name).gnss
        assert (gnss.markov_position.sigma, gnss.latency) == (0.0, 0.0)
    for name in ("figure8", "gnss_outage"):
        gnss = scenario.load(name).gnss
        assert (gnss.markov_position.sigma, gnss.markov_position.time) == (0.5, 60.0)
        assert gnss.latency > 0.0
    assert scenario.load("gnss_outage").gnss.outages
    spiral = scenario.load("square_spiral")
    assert (spiral.imu.rate, spiral.heading.sigma_deg, spiral.gnss.rate) == (10, 1.0, 1)
    assert spiral.imu.gyro.noise * 10**0.5 == pytest.approx(0.005)
    assert spiral.imu.accel.noise * 10**0.5 == pytest.approx(0.01)


def test_a_noise_matched_variant_is_a_replacement():
    quad = scenario.load("quad_mission")
    gyro = dataclasses.replace(quad.imu.gyro, scale_factor=0.0, quantum=0.0, full_scale=None)
    matched = dataclasses.replace(quad, imu=dataclasses.replace(quad.imu, gyro=gyro))
    assert matched.imu.gyro == TriadSettings(noise=3e-4, bias=0.005, bias_walk=1e-5)
    assert matched.trajectory() is quad.trajectory()
