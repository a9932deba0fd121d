import jax
import numpy as np
import pytest

from jaxest import kinematics, models
from jaxest.cli.demo import sensors
from jaxest.filters import run
from jaxest.systems import deflection, deflection_scatter

STEPS = 400


@pytest.fixture(scope="module")
def drawn():
    """Data of the filter's own model, the arm's sensors with a walk of .05 rad a step, and how to judge an estimate."""
    robot, looks = kinematics.load(models.path("arm")), sensors()
    system = deflection.build(robot, looks, particles=128, proposal=deflection.guided)
    params = jax.tree.map(lambda x: np.asarray(x, np.float32), system.default_params)
    params = params._replace(walk=np.float32(400), prior=np.float32(1e4), start=np.float32(robot.home))
    key = jax.random.key(3)
    measurements, _ = system.simulate(params, key=key, steps=STEPS, missing=0.3)

    def judge(params, measurements):
        state = system.init(params, key=key)
        _, found = run(system.step, params, state, measurements, key=key)
        return deflection_scatter.scatter(robot, looks, params, found.mean, found.covariance, measurements)

    return params, measurements, judge


@pytest.mark.slow
def test_sensors_as_good_as_they_are_said_to_be_have_a_ratio_of_one(drawn):
    params, measurements, judge = drawn
    found = judge(params, measurements)
    assert (np.abs(found.ratio - 1) < 3.5 / np.sqrt(2 * found.spare)).all(), found
    there = [
        measurements.encoders.valid.sum() * 4,
        *(2 * m.valid.sum() for m in (measurements.imu2, measurements.imu3)),
    ]
    np.testing.assert_array_equal(found.readings, [*there, 3 * measurements.marker.valid.sum()])


def test_a_noise_that_is_said_ten_times_too_large_is_found(drawn):
    params, measurements, judge = drawn
    given = params.sensors
    wide = given._replace(
        encoders=given.encoders._replace(concentration=given.encoders.concentration / 100),
        **{name: getattr(given, name)._replace(lam=getattr(given, name).lam / 100) for name in ("imu2", "imu3")},
        marker=given.marker._replace(variance=given.marker.variance * 100),
    )
    found = judge(params._replace(sensors=wide, walk=np.float32(5)), measurements)  # a narrow walk would lag behind
    np.testing.assert_allclose(found.ratio, 0.1, rtol=0.25)
