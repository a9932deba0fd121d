"""IMUs of other rates than each other's, and gyroscopes slower than their accelerometers: no turn is lost."""

from types import SimpleNamespace

import numpy as np

from jaxest.cli.methods import deflection_streams, imu_steps, orientation_filters
from jaxest.cli.methods.deflection_config import Described
from jaxest.io import SensorLog, Stream

TURN = np.c_[np.arange(200.0), np.zeros((200, 2))]  # a rate that counts samples


def logged(**rates):
    """IMUs for 2 s: of each the rate of its gyroscope and of its accelerometer, both divisors of 100 Hz."""
    time, streams = np.arange(200) / 100, {}
    for name, hz in rates.items():
        for kind, unit, one in zip(imu_steps.KINDS, ("rad/s", "m/s2"), hz, strict=False):
            rows = slice(None, None, 100 // one)
            streams[f"{name}/{kind}"] = Stream(time[rows], TURN[rows], unit)
    return SensorLog(streams)


def test_each_gyroscope_holds_for_its_own_interval():
    log = logged(quick=(100, 100), slow=(50, 50), lazy=(20, 100))
    steps = imu_steps.merged(log, ["quick/", "slow/", "lazy/"], imu_steps.KINDS[:2], "error")
    assert len(steps.time) == 200
    for name, every in (("quick", 1), ("slow", 2), ("lazy", 5)):
        value, valid = steps.readings[f"{name}/gyroscope"]
        assert valid.all()
        np.testing.assert_array_equal(value, TURN - TURN % every)
    assert steps.readings["slow/accelerometer"].valid.sum() == 100  # said once, seen once
    assert imu_steps.rateless(steps, ["quick/", "slow/", "lazy/"]) == []


def test_a_gyroscope_that_ends_is_told():
    log = logged(trunk=(100, 100), hand=(50, 50))
    item = log.streams["hand/gyroscope"]
    short = {**log.streams, "hand/gyroscope": item._replace(time=item.time[:50], value=item.value[:50])}
    steps = imu_steps.merged(SensorLog(short), ["trunk/", "hand/"], imu_steps.KINDS[:2], "error")
    (told,) = imu_steps.rateless(steps, ["trunk/", "hand/"])
    assert told == "49 % of the steps have no angular rate of hand/gyroscope, more than 10 %"


def test_an_orientation_for_deflection_misses_no_turn(monkeypatch):
    """A gyroscope at half its accelerometer's rate."""
    given = []

    def run(chosen, sensors, measurements):
        given.append(measurements)
        return SimpleNamespace(valid=np.ones(200, bool), quaternion=np.zeros((200, 4)))

    monkeypatch.setattr(orientation_filters, "run", run)
    one = Described(None, "hand/orientation", "hand", "ekf", "wxyz")
    item, lacks = deflection_streams._attitude(logged(hand=(50, 100)), one, "error")
    assert (len(item.time), lacks) == (200, [])
    assert given[0].gyroscope.valid.all()
