"""Live use: the same numbers as a recorded run, whatever the source; late, missing and broken samples; checkpoints."""

import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxest import live
from jaxest.filters import run
from jaxest.filters.complementary import Imu
from jaxest.live import latency
from jaxest.systems import orientation
from jaxest.types import LOST, InputError, Reading

STEPS = 60


@pytest.fixture(scope="module")
def imu():
    """A system, its simulated measurements as NumPy arrays, and their stamps."""
    system = orientation.build()
    params = jax.tree.map(jnp.float32, system.default_params)
    measurements, _ = system.simulate(params, key=jax.random.key(0), steps=STEPS)
    measurements = jax.tree.map(np.asarray, measurements)
    time = np.cumsum(measurements.dt.astype(np.float64))
    # differences of the stamps, so that live and recorded see the same steps
    dt = np.diff(time, prepend=time[0]).astype(np.float32)
    return system, params, measurements._replace(dt=dt), time


def samples(measurements, time):
    names = ("gyroscope", "accelerometer", "magnetometer")
    rows = ({name: getattr(measurements, name).value[i].tolist() for name in names} for i in range(len(time)))
    return [live.Sample(float(t), row) for t, row in zip(time, rows, strict=True)]


def template():
    three = Reading(np.zeros(3, np.float32), np.zeros((), bool))
    return Imu(three, three, three, np.float32(0))


def driven(imu, source, **options):
    system, params, *_ = imu
    seen = []
    outcome = live.drive(
        system.step, params, system.init(params), source, template(), emit=lambda t, info: seen.append(info.quaternion),
        deadline=10.0, **options,
    )  # fmt: skip
    return outcome, np.asarray(seen)


def expected(imu):
    system, params, measurements, _ = imu
    return np.asarray(run(system.step, params, system.init(params), measurements)[1].quaternion)


def test_a_queue_gives_the_numbers_of_a_recorded_run(imu):
    pipe: queue.SimpleQueue = queue.SimpleQueue()
    for sample in [*samples(*imu[2:]), None]:
        pipe.put(sample)
    outcome, found = driven(imu, live.from_queue(pipe))
    assert (outcome.steps, outcome.late, outcome.broken, outcome.ended) == (STEPS, 0, 0, "the source ended")
    assert outcome.latency.number == STEPS
    np.testing.assert_allclose(found, expected(imu), atol=2e-6)


@pytest.mark.parametrize("busy", [False, True])
def test_a_udp_port_gives_them_too(imu, busy):
    def send(address):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for sample in samples(*imu[2:]):
                sender.sendto(json.dumps({"time": sample.time, **sample.values}).encode(), address)
            sender.sendto(b"{broken", address)
            sender.sendto(b"", address)

    outcome, found = driven(imu, live.from_udp(0, ready=send, busy=busy))
    assert (outcome.steps, outcome.broken) == (STEPS, 1)
    assert "not a line of JSON" in outcome.messages[0]
    np.testing.assert_allclose(found, expected(imu), atol=2e-6)


@pytest.mark.parametrize("busy", [False, True])
def test_a_silent_port_is_idle(busy):
    source = live.from_udp(0, wait=0.01, busy=busy)
    assert [next(source) for _ in range(2)] == [live.IDLE] * 2
    source.close()


def test_a_file_is_followed_while_it_grows(imu, tmp_path):
    path = tmp_path / "log.jsonl"
    lines = [json.dumps({"time": s.time, **s.values}) for s in samples(*imu[2:])]

    def write():
        with path.open("w") as file:
            for i, line in enumerate(lines):
                file.write(line[:20])
                file.flush()
                if i % 20 == 0:
                    time.sleep(0.02)
                file.write(line[20:] + "\n")

    writer = threading.Thread(target=write)
    writer.start()
    outcome, found = driven(imu, live.from_file(path), limit=STEPS)
    writer.join()
    assert (outcome.steps, outcome.broken, outcome.ended) == (STEPS, 0, "enough")
    np.testing.assert_allclose(found, expected(imu), atol=2e-6)


def test_late_missing_and_broken_samples_are_counted_and_named(imu):
    good = samples(*imu[2:])
    none = live.Sample(good[3].time + 1e-4, {"gyroscope": [0, 0, 0], "magnetometer": None, "barometer": None})
    nan = live.Sample(good[3].time + 2e-4, {"gyroscope": [0, float("nan"), 0], "accelerometer": [1e300, 0, 0]})
    wrong = live.Sample(good[4].time, {"gyroscope": [0, 0]})
    unknown = live.Sample(good[4].time, {"gyroscop": [0, 0, 0]})
    outcome, found = driven(imu, iter([*good[:4], good[2], none, nan, wrong, unknown, live.IDLE, good[4]]))
    assert (outcome.steps, outcome.late, outcome.broken) == (7, 1, 2)
    assert outcome.masked == {"accelerometer": 2, "magnetometer": 2, "gyroscope": 1}
    assert np.isfinite(found).all()
    late, shape, name = outcome.messages
    assert "refused as late" in late
    assert "(2,), expected (3,)" in shape
    assert "did you mean 'gyroscope'" in name


def test_a_run_goes_on_from_its_checkpoint(imu, tmp_path):
    good, path = samples(*imu[2:]), tmp_path / "state.npz"
    driven(imu, iter(good[:25]), save=path)
    system, params, *_ = imu
    kept = live.resume(path, system.init(params))
    assert kept.time == good[24].time
    outcome = live.drive(system.step, params, kept.state, iter(good[25:]), template(), last=kept.time, deadline=1.0)
    whole, _ = driven(imu, iter(good))
    assert jax.tree.all(jax.tree.map(np.array_equal, whole.state, outcome.state))


def test_what_a_state_has_seen_is_told_once():
    outcome = counted(range(9), last=4.0)
    assert (outcome.steps, outcome.late) == (4, 5)
    assert outcome.messages == ("sample at 0.000000 s: the state has seen all up to 4.000000 s; these are refused",)


def test_a_failing_source_leaves_a_checkpoint(imu, tmp_path):
    def failing():
        yield from samples(*imu[2:])[:5]
        raise RuntimeError("the cable")

    with pytest.raises(RuntimeError, match="the cable"):
        driven(imu, failing(), save=tmp_path / "state.npz")
    system, params, *_ = imu
    assert live.resume(tmp_path / "state.npz", system.init(params)).state.index == 5


def test_a_checkpoint_that_cannot_be_written_is_told_and_stops_nothing(imu, tmp_path):
    folder = tmp_path / "kept"
    folder.mkdir()

    def source():
        folder.rmdir()
        yield from samples(*imu[2:])

    outcome, _ = driven(imu, source(), save=folder / "state.npz", save_every=100.0)
    assert outcome.steps == STEPS
    assert "no checkpoint" in outcome.messages[-1]


class Seen(NamedTuple):
    """Info of a step that only adds up; its compilation costs next to nothing."""

    total: object
    status: object


def added(params, state, measurement, *, key=None):
    total = state + measurement.dt
    rate = measurement.gyroscope.value[0]
    return total, Seen(total, jnp.where(rate > 10, rate - 98, 0).astype(jnp.int32))


def counted(stamps, turning=(), status=1, **options):
    source = (live.Sample(float(t), {"gyroscope": [98 + status if t in turning else 1, 0, 0]}) for t in stamps)
    return live.drive(added, None, jnp.float32(0), source, template(), deadline=10.0, **options)


def test_a_folder_that_is_not_there_is_told_before_the_first_sample(tmp_path):
    with pytest.raises(InputError, match="its folder does not exist"):
        counted([1], save=tmp_path / "none" / "state.npz")


@pytest.mark.parametrize("wrong", [(1e15,), (1e300, 1e15), (3 + 61,)])
def test_a_wrong_stamp_does_not_make_all_later_samples_late(wrong):
    told = []
    outcome = counted([1, 2, 3, *wrong, 4, 5], tell=told.append)
    assert (outcome.steps, outcome.late, outcome.broken, outcome.time) == (5, 0, len(wrong), 5)
    assert float(outcome.state) == 4
    assert "more than 60 s from the one before" in outcome.messages[0]
    assert tuple(told) == outcome.messages


@pytest.mark.parametrize("wrong", [1e9, pytest.param(-1e9, marks=pytest.mark.slow)])
def test_a_first_stamp_that_is_wrong_does_not_either(wrong):
    outcome = counted([wrong, 1, 2, 3, 2, 4])
    assert (outcome.steps, outcome.late, outcome.broken, outcome.time) == (4, 1, 1, 4)
    assert float(outcome.state) == 3
    outcome = counted([1, wrong, 2, 3])
    assert (outcome.steps, outcome.late + outcome.broken, outcome.time) == (3, 1, 3)
    outcome = counted([1, 2, -100, -99])  # two that agree: a clock that starts again
    assert (outcome.steps, outcome.late) == (2, 2)


def test_what_is_no_sample_or_has_no_finite_stamp_is_refused():
    good = [live.Sample(float(t), {"gyroscope": [1, 0, 0]}) for t in range(3)]
    stamps = [good[0]._replace(time=t) for t in (float("nan"), None, float("inf"), "1", 10**400)]
    source = iter([*stamps[:1], good[0], *stamps[1:], (1.0, {}), {"time": 1.5}, live.IDLE, *good[1:]])
    outcome = live.drive(added, None, jnp.float32(0), source, template(), deadline=10.0)
    assert (outcome.steps, outcome.late, outcome.broken, outcome.time) == (3, 0, 7, 2)
    assert outcome.messages[0] == "sample with the stamp nan, expected a finite number of seconds"
    told = []
    source = iter([(1.0, {}), {}, live.Sample(1.0, None)])
    live.drive(added, None, jnp.float32(0), source, template(), tell=told.append)
    assert told == [
        "got tuple, expected a Sample",
        "got dict, expected a Sample",
        "sample at 1.000000 s: values: got NoneType, expected a value for each stream by name",
    ]


def test_after_a_long_silence_the_second_sample_is_believed():
    stamps = [1, 2, 1002, 1003, 1004]
    outcome = counted(stamps)
    assert (outcome.steps, outcome.broken, outcome.time, float(outcome.state)) == (4, 1, 1004, 1003)
    patient = counted(stamps, gap=2000.0)
    assert (patient.steps, patient.broken, float(patient.state)) == (5, 0, 1003)
    with pytest.raises(ValueError, match="gap: got 0"):
        counted(stamps, gap=0.0)


@pytest.mark.parametrize(("status", "meaning"), [(1, " (a valid"), (LOST, " (what the sensors see"), (77, "")])
def test_a_step_with_a_status_is_counted_and_the_first_is_told(status, meaning):
    outcome = counted(range(6), turning=(2, 4), status=status)
    assert (outcome.steps, outcome.flagged) == (6, 2)
    (message,) = outcome.messages
    assert message.startswith(f"step at 2.000000 s: status {status}{meaning}")
    assert meaning or message.endswith("77")


CODE = """
import sys, time
import numpy as np
from jaxest import live
from jaxest.filters.complementary import Imu
from jaxest.systems import orientation
from jaxest.types import Reading

three = Reading(np.zeros(3, np.float32), np.zeros((), bool))
def source():
    for i in range(10**6):
        if i == 20:
            print("going", flush=True)
        time.sleep(0.001)
        yield live.Sample(0.001 * i, {"gyroscope": [0, 0, 0], "accelerometer": [0, 0, 9.81]})
system = orientation.build(None, ("gyroscope", "accelerometer"))
params = system.default_params
outcome = live.drive(system.step, params, system.init(params), source(), Imu(three, three, None, np.float32(0)),
                     save=sys.argv[1], save_every=0.05)
print(outcome.ended, outcome.steps)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_stopped_by_a_signal_it_leaves_a_whole_checkpoint(tmp_path, number):
    path = tmp_path / "state.npz"
    child = subprocess.Popen([sys.executable, "-c", CODE, str(path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "going\n"
    while not path.exists():
        time.sleep(0.01)
    os.kill(child.pid, number)
    out, _ = child.communicate(timeout=60)
    system = orientation.build(None, ("gyroscope", "accelerometer"))
    with jax.enable_x64(False):
        kept = live.resume(path, jax.eval_shape(system.init, system.default_params))
    assert int(kept.state.index) > 0
    if number == signal.SIGINT:
        assert out.split()[0] == "interrupted"
        assert int(out.split()[1]) == int(kept.state.index)


@pytest.mark.parametrize(
    ("line", "part"),
    [
        ("[1, 2]", "a JSON list"),
        ('{"gyroscope": [1]}', "'time' is None"),
        ('{"time": true}', "'time' is True"),
        ('{"time": NaN}', "'time' is nan"),
        ('{"time": 1' + 400 * "0" + "}", "expected a finite number of seconds"),
        ('{"time": 1, "gyroscope": "abc"}', "stream 'gyroscope'"),
        ('{"time": 1, "gyroscope": [[[[[[1]]]]]]}', "expected numbers or null"),
        ("[" * 100000, "not a line of JSON"),
        (b"\xff\xfe{}", "not a line of JSON"),
    ],
)
def test_lines_that_are_no_samples_are_named(line, part):
    with pytest.raises(InputError, match=r"^here: ") as caught:
        live.parse(line, "here")
    assert part in str(caught.value)


def test_a_port_in_use_and_a_missing_file_are_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        next(live.from_file(tmp_path / "none.jsonl", follow=False))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        with pytest.raises(InputError, match="cannot listen"):
            next(live.from_udp(holder.getsockname()[1]))


def test_a_file_that_is_replaced_is_read_from_its_start(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_text('{"time": 1}\n{"time": 2}\n')
    source = live.from_file(path, wait=0)
    assert [next(source).time for _ in range(2)] == [1, 2]
    path.write_text('{"time": 3}\n')
    found = next(item for item in source if item is not live.IDLE)
    assert found.time == 3


def test_a_file_that_is_replaced_is_first_read_to_its_end(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_text('{"time": 0}\n')
    source = live.from_file(path, wait=0)
    assert next(source).time == 0
    with path.open("a") as file:
        file.writelines(f'{{"time": {i}, "gyroscope": {[0.1] * 1000}}}\n' for i in range(1, 50))
        file.write('{"time": 50, "gy')
    path.rename(tmp_path / "log.1")
    path.write_text('{"time": 51}\n')
    found = [item for item in (next(source) for _ in range(60)) if item is not live.IDLE]
    assert [item.time for item in found if isinstance(item, live.Sample)] == [*range(1, 50), 51]
    (broken,) = (item for item in found if isinstance(item, str))
    assert "line 51: not a line of JSON" in broken


def test_a_file_that_is_replaced_again_and_again_stays_one_open_file(tmp_path):
    path = tmp_path / "log.jsonl"
    open_files = Path("/proc/self/fd")
    if not open_files.exists():
        pytest.skip("this system does not tell which files are open")
    source, before = live.from_file(path, wait=0), len(list(open_files.iterdir()))
    for i in range(20):
        (tmp_path / "new").write_text(f'{{"time": {i}}}\n')
        (tmp_path / "new").replace(path)
        assert next(item for item in source if item is not live.IDLE).time == i
    assert len(list(open_files.iterdir())) <= before + 1
    source.close()
    assert len(list(open_files.iterdir())) <= before


def test_a_pipe_is_read_as_it_comes_until_it_is_closed(imu):
    good = samples(*imu[2:])
    lines = [json.dumps({"time": one.time, **one.values}).encode() for one in good]
    out, into = os.pipe()
    with os.fdopen(out, "rb") as reading:
        source = live.from_stream(reading, wait=0.01)
        assert next(source) is live.IDLE
        os.write(into, lines[0] + b"\nnoise\n" + lines[1][:20])
        assert next(source).time == good[0].time  # though the second line is not whole
        assert "line 2: not a line of JSON" in next(source)
        assert next(source) is live.IDLE
        os.write(into, lines[1][20:] + b"\n" + lines[2])
        os.close(into)
        assert [item.time for item in source] == [good[1].time, good[2].time]


def test_a_pipe_that_is_taken_for_a_file_is_named(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match=r"is a pipe or a device.*from_stream"):
        next(live.from_file(tmp_path / "pipe"))


def test_a_measurement_keeps_its_numbers_where_the_sender_uses_its_array_again():
    sent = np.ones(3, np.float32)
    measurement = live.measurement_of(template(), live.Sample(0.0, {"gyroscope": sent}), 0.0)
    sent[:] = 7
    np.testing.assert_array_equal(measurement.gyroscope.value, np.ones(3))


def test_histogram_against_numpy():
    draws = np.random.default_rng(0).lognormal(np.log(2e-4), 1.0, 5000)
    found = latency.empty()
    for value in draws:
        found = latency.counted(found, value)
    assert found.number == len(draws)
    assert found.longest == draws.max()
    for share in (0.5, 0.9, 0.999):
        exact = np.quantile(draws, share, method="inverted_cdf")
        assert exact <= found.quantile(share) <= exact * 1.05
    within = found.share_within(1e-3)
    assert np.mean(draws <= 0.95e-3) <= within <= np.mean(draws <= 1e-3)
    both = latency.joined(found, latency.counted(latency.empty(), 2.0))
    assert (both.number, both.longest) == (found.number + 1, max(found.longest, 2.0))
    assert both.total == found.total + 2.0
    assert latency.empty().share_within(1.0) == 0
    assert np.isnan(latency.empty().quantile(0.5))
