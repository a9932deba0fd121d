"""What whole-body SLAM takes, keeps and returns."""

from typing import NamedTuple

from jaxest.mapping import VoxelMap
from jaxest.systems._slam_body import Mean
from jaxest.systems._slam_tilt import Mounts
from jaxest.types import FOLLOWS, FULL, LOST, UNSEEN, Array, ArrayLike, Reading


class Params(NamedTuple):
    """What may be tuned."""

    noise: ArrayLike = 0.01 / 2.7
    """() standard deviation of a range, by the range."""
    floor: ArrayLike = 0.001
    """() m, standard deviation of a distance to a plane however near: rows on one plane share its error, and are
    counted for less instead."""
    uneven: ArrayLike = 0.002
    """() m, standard deviation of a voxel's point however often it was read."""
    lasting: ArrayLike = 5e-5
    """() m, of the distance to a plane that is the same in every scan, without noise."""
    share: ArrayLike = 2.0
    """() 1/m, the same by the variance of a reading: noise that does not average out is of second order."""
    fresh: ArrayLike = 15.0
    """() by how much more a distance's variance is, for a plane of voxels that were read once each."""
    rough: ArrayLike = 15.0
    """() by how much a distance's variance is more than that, by the readings' where voxels were read once: such planes
    lie askew."""
    tilt: ArrayLike = 0.0
    """() rad, standard deviation of a sensor's direction about each axis, before the first scan: `build(align=True)`
    estimates the directions, otherwise residuals and links are trusted less for it."""
    gate: ArrayLike = 0.04
    """() m^0.5, a residual beyond this times the root of its range, and three times its noise, does not count."""
    thickness: ArrayLike = 0.005
    """() m, of a plane at most, beyond a range's standard deviation."""
    stray_position: ArrayLike = 1e-5
    """() m, standard deviation along each axis of where the map's own errors place a link, without noise."""
    stray_rotation: ArrayLike = 1e-5
    """() rad, the same of its rotation."""
    stray: ArrayLike = 2.0
    """() rad, what noise adds to both: by `noise` squared, as a rotation, and as a position from afar."""
    renewal: ArrayLike = 0.2
    """() m, that a link must go to see the map with other errors; what it sees before that tells little new."""
    bias_start: ArrayLike = 0.1
    """() or (n,) rad or m, standard deviation of a bias before the first scan."""
    bias_walk: ArrayLike = 1e-5
    """() or (n,) rad or m per root s, growth of it; an encoder that is off stays so."""
    encoder: ArrayLike = 1e-4
    """() or (n,) rad or m, white noise of a reading."""
    missing: ArrayLike = 0.1
    """() or (n,) rad or m, how far a joint may be from its last reading while none comes."""
    root_walk: ArrayLike = 0.0316
    """() or (6,) m and rad per root s, how a free root wanders where no odometry comes."""
    swing: ArrayLike = 0.5
    """() by what share of the last step's motion the next one may differ, where no odometry comes."""
    search: ArrayLike = 0.5
    """() rad, how far a free root is looked for about each axis where it is not as predicted; a quarter of it in m."""
    travel: ArrayLike = 0.01
    """() m, standard deviation of a step's `travel`. One that is wrong by half a metre, within which points are matched
    is taken for a way into what was not seen before: the room is mapped again there, with no status."""
    turn: ArrayLike = 0.005
    """() rad, standard deviation of a step's `turn`."""
    admit: ArrayLike = 0.15
    """() m, points of a link known worse than this stay out of the map."""


class Fixed(NamedTuple):
    """What a robot with a fixed root measures in a step."""

    ranges: Reading
    """(R,) m, and which there are (R,); zone after zone of sensor after sensor."""
    joints: Reading
    """(n,) rad or m, encoders, and which there are (n,)."""
    dt: Array
    """() s."""


class Free(NamedTuple):
    """What a robot with a free root measures in a step."""

    ranges: Reading
    """As in `Fixed`."""
    joints: Reading
    """As in `Fixed`."""
    travel: Reading
    """(3,) m, how the root moved since the step before, in its own axes then: wheel odometry; unused at the first."""
    turn: Reading
    """(3,) rad, how it turned, in its own axes: an integrated gyroscope; unused at the first step."""
    dt: Array
    """() s."""


class State(NamedTuple):
    """What the next step needs."""

    mean: Mean
    covariance: Array
    """(D, D), [root's position, rotation in the root, biases]."""
    chart: VoxelMap
    reference: Array
    """(n,) biases at which the map's points stand, or (n + 3 L,) with what the sensors of links have in common; less
    than 1e-3 from what is believed."""
    reading: Array
    """(n,) last reading of each encoder."""
    pace: Array
    """(6,) m/s and rad/s, how a free root moved in the last step, in its own axes then."""
    usual: Array
    """() share of the first link's points about which there was a map that lay on its planes."""
    mounts: Mounts | None
    """How sensors are turned, where that is estimated."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, steps seen."""


class Info(NamedTuple):
    """The estimate of one step; B bodies, L of them with sensors."""

    position: Array
    """(B, 3) m, of every body."""
    quaternion: Array
    """(B, 4) wxyz, body to world."""
    pose_covariance: Array
    """(B, 6, 6), rotation and translation along the world's axes, at the body's origin, relative to where the root was
    at the first scan."""
    joints: Array
    """(n,) rad or m, reading less bias."""
    bias: Array
    """(n,) rad or m."""
    bias_deviation: Array
    """(n,) rad or m."""
    inliers: Array
    """(L,) int32, points that counted."""
    matched: Array
    """(L,) int32, points with enough of the map about them."""
    seen: Array
    """(L,) int32, points there were among those whose turn it was."""
    weakest: Array
    """(L,) smallest eigenvalue of H' R^-1 H of the link's own pose: what its scan does not see is small."""
    nis: Array
    """(L,) mean square of the residuals that counted, in the variance that readings and planes give them: about 1."""
    link_status: Array
    """(B,) int32, `OK`, `FOLLOWS`, `LOST` or `UNSEEN`."""
    voxels: Array
    """() int32, points of the map."""
    overflow: Array
    """() int32, points so far that found no room in it."""
    status: Array
    """() int32, `OK`, `NON_FINITE`, `NOT_CONVERGED`, `LOST`, `FULL`, or `OUT_OF_RANGE` (belief as before)."""


__all__ = ["FOLLOWS", "FULL", "LOST", "UNSEEN", "Fixed", "Free", "Info", "Params", "State"]
