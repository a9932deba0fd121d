"""The packaged arm with a sensor of each sort, as a deflection filter: for the contract and for its own tests."""

from functools import cache

from jaxest import kinematics, models
from jaxest.sensors import Sensor
from jaxest.systems import deflection

SENSORS = (
    Sensor("joint_angle", "encoders"),
    Sensor("link_orientation", "imu2", ("site:imu2",)),
    Sensor("link_orientation", "imu3", ("site:imu3",)),
    Sensor("link_position", "tip", ("site:end_effector",)),
)
"""As in Sato 2023, Table I."""
FEW = SENSORS[:1] + SENSORS[2:]


@cache
def arm():
    return kinematics.load(models.path("arm"))


@cache
def build(proposal=deflection.bootstrap, sensors=SENSORS, particles=32, **options):
    system = deflection.build(arm(), sensors, particles=particles, proposal=proposal, **options)
    # A few particles spread over all postures would leave some without any weight at the first step.
    return system._replace(default_params=system.default_params._replace(prior=30.0))
