"""A stand-in for the estimator, and a solution for it to give."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mavins.estimator.feed import by_turns
from mavins.estimator.settings import Settings
from mavins.nav.earth import TangentFrame
from mavins.types import Health, NavSolution, Origin

ORIGIN = Origin(math.radians(47.0), math.radians(8.0), 400.0)


def make_solution(t_us: int, health: Health = Health.RUNNING, resets: int = 0) -> NavSolution:
    half = 0.25
    q = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
    lat, lon, alt = TangentFrame.at(ORIGIN).to_lla(np.array([10.0, -5.0, -20.0]))
    return NavSolution(
        t_us=t_us,
        lat=lat,
        lon=lon,
        alt=alt,
        p_n=np.array([10.0, -5.0, -20.0]),
        v_n=np.array([3.0, -1.0, 0.5]),
        q_nb=q,
        v_l=np.array([3.0, -1.0, 0.5]),
        q_lb=q,
        roll=0.0,
        pitch=0.0,
        yaw=0.5,
        w_b=np.zeros(3),
        f_b=np.array([0.0, 0.0, -9.8]),
        b_g=np.zeros(3),
        b_a=np.zeros(3),
        P=np.eye(15) * 0.04,
        sd_euler=np.full(3, 0.2),
        l_b=np.zeros(3),
        sd_l_b=np.zeros(3),
        tau=0.0,
        sd_tau=0.0,
        b_baro=0.0,
        sd_b_baro=0.0,
        b_m=np.zeros(3),
        sd_b_m=np.zeros(3),
        g_n=np.zeros(2),
        sd_g_n=np.zeros(2),
        health=health,
        reset_counter=resets,
    )


class FakeEstimator:
    """As much of an estimator as a session looks at; a test sets what it likes."""

    def __init__(self) -> None:
        self.settings = Settings()
        self.t_us: int | None = None
        self.health = Health.WAITING
        self.reason = "waiting for IMU and GNSS"
        self.reset_counter = 0
        self.realignments = 0
        self.loss = ""
        self.imu_rows = 0
        self.frame: TangentFrame | None = None
        self.statistics: dict[str, Any] = {}
        self.dropped: Counter[str] = Counter()
        self.origins: list[Origin] = []
        self.feeds = 0
        self.calibrations = 0
        self.may_calibrate = True

    @property
    def running(self) -> bool:
        return self.health in (Health.RUNNING, Health.DEAD_RECKONING)

    def start(self, t_us: int) -> None:
        """From now on there is an estimate."""
        self.t_us = t_us
        self.health = Health.RUNNING
        self.reason = ""
        self.frame = TangentFrame.at(ORIGIN)

    def solution(self) -> NavSolution | None:
        if not self.running or self.t_us is None:
            return None
        return make_solution(self.t_us, self.health, self.reset_counter)

    def yaw_from_motion(self) -> tuple[float, float] | None:
        return None

    @property
    def standing(self) -> bool | None:
        return None

    def imu_after(self, t_us: int) -> tuple[Any, Any]:
        return np.empty(0, np.int64), np.empty((0, 6))

    def set_origin(self, origin: Origin) -> None:
        self.origins.append(origin)

    def feed_imu(self, table: Any) -> None:
        self.imu_rows += len(table)
        self.t_us = int(table.t_us[-1])

    def feed_run(self, table: Any, between: Any) -> None:
        by_turns(self, table, between)  # type: ignore[arg-type]

    def feed_gnss(self, fix: Any) -> None:
        self.feeds += 1

    def feed_heading(self, fix: Any) -> None:
        self.feeds += 1

    def calibrate(self, reason: str) -> bool:
        self.calibrations += self.may_calibrate
        return self.may_calibrate

    def restart(self, reason: str) -> None:
        self.reason = reason


@pytest.fixture
def estimator() -> FakeEstimator:
    return FakeEstimator()


@pytest.fixture
def make_estimator() -> Callable[[], FakeEstimator]:
    return FakeEstimator


@pytest.fixture
def solution() -> Callable[..., NavSolution]:
    return make_solution
