import jax
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest import bench, kinematics, models
from jaxest.bench import attitude_peers, posture_loop
from jaxest.bench import posture as case
from jaxest.bench.onsite_loop import loop
from jaxest.filters import complementary, pair, run
from jaxest.metrics import orientation_error
from jaxest.systems import onsite, orientation, posture
from jaxest.types import InputError


def test_unknown_case():
    with pytest.raises(InputError, match="does not exist, expected one of bingham"):
        bench.rows("orientaton")


def test_robots_are_for_kinematics():
    with pytest.raises(InputError, match=r"is not about robots, got panda\.xml"):
        bench.rows("orientation", robots=["panda.xml"])


@pytest.mark.slow
@pytest.mark.parametrize("peers", ["installed", "absent", "unwanted"])
def test_orientation(peers, monkeypatch):
    if peers == "absent":
        for module in ("orientation", "attitude_peers"):
            monkeypatch.setattr(f"jaxest.bench.{module}.find_peer", lambda name: None)
    heard = []
    rows = list(bench.rows("orientation", peers=peers != "unwanted", progress=heard.append, small=True))
    assert heard
    metrics = [row.metric for row in rows]
    others = [] if peers == "unwanted" else ["live step"] * len(attitude_peers.PEERS)
    assert metrics == ["live step", "compile"] * 2 + others + ["batched step", "compile"] * 3
    assert all(row.value > 0 for row in rows)
    timed = [row for row in rows if row.metric != "compile"]
    if peers == "installed":
        pytest.importorskip("vqf")
        beside = [row for row in timed if "not installed" not in row.reference_name]
        assert all(row.ratio > 0 and row.reference > 0 for row in beside)
        assert sum("VQF" in row.reference_name for row in beside) == 5
    else:
        assert all(row.ratio is None for row in timed)
        assert all((row.reference_name is not None) == (peers == "absent") for row in timed)


@pytest.mark.parametrize("axes", [6, 9])
def test_other_attitude_filters_find_the_orientation(axes):
    """A peer that computes something else would be no peer."""
    pytest.importorskip("ahrs")
    system = orientation.build()
    measurements, truth = system.simulate(
        system.default_params, key=jax.random.key(0), steps=1500, rate_hz=100.0, shaking=0.1
    )
    names = ("gyroscope", "accelerometer", "magnetometer")
    sensors = {name: np.asarray(getattr(measurements, name).value, float) for name in names}
    found = attitude_peers.estimates(sensors, 0.01, axes)
    assert found.keys() == attitude_peers.PEERS.keys()
    for name, quaternions in found.items():
        error = orientation_error(quaternions[1000:], np.asarray(truth.quaternion)[1000:])
        part = error.total if axes == 9 else error.inclination
        assert np.rad2deg(np.sqrt(np.mean(np.asarray(part) ** 2))) < 12, name


@pytest.mark.slow
def test_import():
    alone, over, whole, more = bench.rows("import", peers=False, small=True)
    assert alone.reference_name == whole.reference_name == "import jax"
    assert alone.value > 0
    assert whole.value > 0
    assert over.metric == more.metric == "over import jax"


@pytest.mark.parametrize("peers", [True, False])
def test_logs(peers):
    pytest.importorskip("rosbags")
    read, rate, *memory = bench.rows("logs", peers=peers, small=True)
    assert (read.ratio is not None) == peers
    assert rate.value * read.value == pytest.approx(1e6)
    assert all(row.value > 0 for row in memory)


@pytest.mark.slow
def test_live():
    within, *steps, lost, grown = bench.rows("live", small=True)
    assert 0 <= within.value <= 100
    assert 0 <= within.reference <= 100
    assert [row.value for row in steps] == sorted(row.value for row in steps)
    assert within.n + lost.value == 500
    assert grown.unit == "MiB"


def test_slam():
    pytest.importorskip("small_gicp")
    beside, other, compiled = bench.rows("slam", small=True)
    assert beside.metric == other.metric == "live step"
    assert beside.value == other.value > 0
    assert beside.ratio > 0
    assert other.ratio > 0
    assert compiled.metric == "compile"


@pytest.mark.slow  # compiles for most of a minute; its loop is tested below
def test_onsite():
    rows = list(bench.rows("onsite", small=True))
    assert [row.metric for row in rows] == ["live step", "compile", "batched step", "batched step", "compile"]
    assert all(row.value > 0 for row in rows)
    assert all(row.ratio > 0 for row in rows if row.metric != "compile")


def test_the_loop_of_the_onsite_benchmark_finds_the_rod():
    """A peer that computes something else would be no peer: its answer is right too."""
    system = onsite.build()
    params = jax.tree.map(np.float32, system.default_params)
    measurements, truth = system.simulate(params, key=jax.random.key(3), steps=1500)
    place, _ = loop(measurements)
    assert np.linalg.norm(place - truth.position) < 3e-3


@pytest.mark.slow  # compiles six programs
def test_posture():
    rows = list(bench.rows("posture", small=True))
    measured = ("live", "batched", "live", "live", "batched", "live")
    assert [row.metric for row in rows if row.metric != "compile"] == [f"{metric} step" for metric in measured]
    assert all(row.value > 0 for row in rows)
    assert [row.ratio is not None for row in rows if row.metric != "compile"] == [True, True, False, True, True, True]


@pytest.mark.slow  # simulates an arm
def test_the_loops_of_the_posture_benchmark_find_the_same():
    """Pairs as the filter has them, and the joints of the arm that was simulated."""
    robot = kinematics.load(models.path("human_arm"))
    system = posture.build(robot, case.ARM, magnetic=True)
    params = jax.tree.map(np.float32, system.default_params)
    draw = jax.jit(lambda key: system.simulate(params, key=key, steps=500, rate_hz=50.0))
    measurements, truth = jax.tree.map(np.asarray, draw(jax.random.key(3)))
    edges = ((0, 1), (1, 2), (2, 3), (1, 3))
    init, step = pair.over(edges, 4)
    gains = complementary.Params(*(np.float32(x) for x in (1.0, 0.01, 1.0, 1.0)))
    found = run(step, gains, init(gains), measurements)[1].quaternion[-1]
    turned = (
        Rotation.from_quat(found, scalar_first=True)
        * Rotation.from_matrix(posture_loop.pairs(measurements, edges)).inv()
    )
    assert np.rad2deg(turned.magnitude()).max() < 0.5
    model = mujoco.MjModel.from_xml_path(str(models.path("human_arm")))
    sites = [model.site(name.removeprefix("site:")).id for name in case.ARM]
    error = posture_loop.posture(model, sites, measurements)[-100:, 7:] - truth.q[-100:, 7:]
    assert np.rad2deg(np.sqrt(np.mean(error**2))) < 3
