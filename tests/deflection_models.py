"""The packaged arm with a sensor of each sort, as a deflection filter: for the contract and for its own tests."""

from functools import cache, partial

import numpy as np

from jaxest import kinematics, models
from jaxest.sensors import Sensor, joint_angle, link_orientation, link_position, slide_position
from jaxest.systems import deflection

SENSORS = (
    Sensor("joint_angle", "encoders"),
    Sensor("link_orientation", "imu2", ("site:imu2",)),
    Sensor("link_orientation", "imu3", ("site:imu3",)),
    Sensor("link_position", "tip", ("site:end_effector",)),
)
"""As in Sato 2023, Table I."""
FEW = SENSORS[:1] + SENSORS[2:]

CRANE = """
<mujoco>
  <worldbody>
    <body name="trolley" pos="0 0 2">
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom size=".1" mass="2"/>
      <body name="arm">
        <joint name="boom" type="hinge" axis="0 1 0"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .4 0 0" mass="1"/>
        <site name="imu"/>
        <body name="cup" pos=".4 0 0">
          <joint name="wrist" type="ball"/>
          <geom size=".05" pos=".1 0 0" mass=".3"/>
          <site name="tip" pos=".2 .05 0"/>
        </body>
      </body>
    </body>
    <body name="buoy" pos="1 1 0"><freejoint name="drift"/><geom size=".1" mass="1"/></body>
  </worldbody>
</mujoco>
"""
"""A joint of every kind."""


@cache
def crane():
    return kinematics.load(CRANE)


def crane_sensors():
    return (
        Sensor("slide_position", "rail"),
        Sensor("joint_angle", "boom"),
        Sensor("link_orientation", "imu", ("site:imu",)),
        Sensor("link_orientation", "cup", ("cup",), link_orientation.Params(link_orientation.unimodal())),
        Sensor("link_position", "tip", ("site:tip",), link_position.Params(np.full(3, 1e-4))),
    )


@cache
def hanging(proposal=deflection.bootstrap, particles=32):
    """The crane as a deflection filter, with sensors that leave a few particles their weight."""
    wide = link_orientation.Params(link_orientation.unimodal(10.0))
    slide, hinge, imu, cup, tip = crane_sensors()
    sensors = (
        slide._replace(params=slide_position.Params(0.01)),
        hinge._replace(params=joint_angle.Params(3.0)),
        imu._replace(params=wide),
        cup._replace(params=wide),
        tip._replace(params=link_position.Params(np.full(3, 0.1))),
    )
    joints = ["rail", "boom", "wrist"]
    system = deflection.build(crane(), sensors, joints=joints, particles=particles, proposal=proposal)
    return system._replace(
        default_params=system.default_params._replace(prior=np.full(5, 30.0)),
        simulate=partial(system.simulate, missing=0.0),
    )


@cache
def arm():
    return kinematics.load(models.path("arm"))


@cache
def build(proposal=deflection.bootstrap, sensors=SENSORS, particles=32, **options):
    system = deflection.build(arm(), sensors, particles=particles, proposal=proposal, **options)
    # A few particles spread over all postures would leave some without any weight at the first step.
    return system._replace(default_params=system.default_params._replace(prior=30.0))
