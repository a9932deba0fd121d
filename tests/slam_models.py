"""A small robot with few zones for tests of whole-body SLAM: hinges about three axes, a slide, a branch."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics
from jaxest.manifolds import quaternion
from jaxest.mapping import Hashed
from jaxest.sensors.proximity import ring
from jaxest.systems import slam, slam_inertial
from jaxest.types import Reading

TREE = """<mujoco model="tree"><worldbody><body name="root">{joint}<geom size="0.03"/>
<body name="a" pos="0.4 0 0"><joint name="ja" axis="0 0 1"/><geom size="0.03"/>
<body name="b" pos="0.4 0 0"><joint name="jb" axis="0 1 0"/><geom size="0.03"/>
<body name="tool" pos="0.2 0 0"><joint name="js" type="slide" axis="1 0 0"/><geom size="0.03"/></body></body></body>
<body name="c" pos="0 0.3 0.1"><joint name="jc" axis="0.6 0 0.8"/><geom size="0.03"/><site name="tip" pos="0.1 0 0"/>
</body></body></worldbody></mujoco>"""


def robot(free=False):
    """Load the tree; its root is fixed or free."""
    return kinematics.load(TREE.format(joint="<freejoint/>" if free else ""))


def sensors(rows=3, columns=3):
    """Rings on the root, a, b and a site of c; none on the tool."""
    return [s for frame in ("root", "a", "b", "site:tip") for s in ring(frame, 0.1, rows=rows, columns=columns)]


def build(free=False, system=slam, **options):
    """Build a SLAM of the tree with a small map; every zone takes part in each update."""
    return system.build(robot(free), sensors(), layout=Hashed(0.25, (32, 32, 16)), capacity=1500, points=72, **options)


def tiny(free=True, system=slam, **options):
    """Build a SLAM of a root and one joint, 32 zones a link, for tests that compile it again and again."""
    text = TREE.format(joint="<freejoint/>" if free else "")
    keep = text[: text.index('<body name="b"')] + "</body></body></worldbody></mujoco>"
    both = [s for frame in ("root", "a") for s in ring(frame, 0.1, rows=2, columns=2)]
    sizes = {"layout": Hashed(0.25, (32, 32, 16)), "capacity": 600, "points": 32, "least": 4}
    return system.build(kinematics.load(keep), both, **(sizes | options))


def aligned():
    """Build the tiny one with turns of its sensors unknown."""
    system = tiny(align=True)
    return system._replace(default_params=system.default_params._replace(tilt=0.02))


def shaken():
    """Build the tiny one with an IMU on its root; its simulation drifts and turns steadily."""
    system = tiny(system=slam_inertial, imu="root")

    def simulate(params, *, key, steps):
        """Draw what `slam` does, and two samples of the IMU a step."""
        first, second = jax.random.split(key)
        given, truth = system.simulate(params, key=first, steps=steps)
        rotation = truth.rotation[:, 0]
        turned = jax.vmap(quaternion.from_matrix)(rotation)
        rate = jax.vmap(quaternion.local)(turned[:-1], turned[1:]) / given.dt[1:, None]
        rate = jnp.concatenate([rate[:1], rate])
        up = rotation[:, 2] * 9.81
        noise = 1e-3 * jax.random.normal(second, (2, steps, 2, 3), rate.dtype)
        there = jnp.ones((steps, 2), bool)
        gyroscope, accelerometer = (Reading(x[:, None] + e, there) for x, e in zip((rate, up), noise, strict=True))
        spacing = jnp.broadcast_to(given.dt[:, None] / 2, (steps, 2))
        return slam_inertial.Driven(given.ranges, given.joints, gyroscope, accelerometer, spacing, given.dt), truth

    return system._replace(simulate=simulate)


def errors(info, truth):
    """Distance of every body from the truth, (T, B) m."""
    return np.linalg.norm(np.asarray(info.position) - np.asarray(truth.position), axis=2)
