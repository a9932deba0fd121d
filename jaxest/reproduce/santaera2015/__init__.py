"""Santaera 2015 (IMU posture): Table I and the gripper's cases, joint angles, calibration, and the filters on BROAD.

The gripper is the packaged one, whose lengths are not the paper's; IMUs have the MPU-6050's noise after a calibration
(`simulate.grasp.calibrated_mpu6050`), mounted some degrees off. With `--broad FOLDER` every filter runs on all trials.
Finished pieces are kept in `--work`, so that a stopped run goes on from there.
"""

from collections.abc import Mapping

from jaxest.reproduce import Part
from jaxest.reproduce.santaera2015 import angles, axes, cases, recorded, table

PARTS: Mapping[str, Part] = {
    "table1": table.table1,
    "cases": cases.cases,
    "angles": angles.angles,
    "calibration": axes.calibration,
    "broad": recorded.broad,
}
"""By the name that `--part` takes."""

TAKES = ("runs", "broad", "work")
NEEDS = {"broad": "broad"}

__all__ = ["NEEDS", "PARTS", "TAKES"]
