"""`jaxest show`: an estimate as a moving picture, or as a recording for Rerun."""

from pathlib import Path
from typing import Annotated, Any

import typer

from jaxest.cli.output import Answer, Force, Json, Verbose, bad_input, command, console, note, working

NAME = "show"
EXAMPLES = (
    "jaxest show out --robot arm.urdf -o arm.gif",
    "jaxest show out --robot arm.urdf --beside log.npz:encoders -o arm.gif",
    "jaxest show out --robot arm.urdf --beside log.csv:joint_position -c log.toml -o arm.gif",
    "jaxest show out --robot arm.xml -o arm.rrd  # with out/slam_map.ply, if there is one",
)
LONGEST = 240  # pictures of a GIF


@command
def run(
    estimate: Annotated[Path, typer.Argument(help="Folder of `estimate`, or LOG or LOG:STREAM with joint angles.")],
    robot: Annotated[Path, typer.Option("--robot", "-r", help="Robot (MJCF, URDF).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="FILE.gif, FILE.png (the last posture) or FILE.rrd.")],
    beside: Annotated[
        str | None, typer.Option(help="LOG or LOG:STREAM with joint angles of a second robot, in red: encoders, truth.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="How the log of --beside is read: a TOML with \\[columns].")
    ] = None,
    cloud: Annotated[
        Path | None, typer.Option("--map", help="Points of a map (PLY, PCD), for .rrd; else that of the folder.")
    ] = None,
    frame: Annotated[
        list[str] | None, typer.Option(help="Frame whose 95 % ellipsoid is drawn, for .rrd; several times.")
    ] = None,
    rate: Annotated[float, typer.Option(min=0.1, help="Pictures a second of the estimate's time.")] = 10.0,
    force: Force = False,
    json: Json = False,
    verbose: Verbose = False,
) -> Answer:
    """Render a robot as it was estimated, or write a recording of it for the Rerun viewer."""
    del verbose
    from jaxest.viz import animation

    animation.choose_renderer()
    import numpy as np

    from jaxest import io, kinematics
    from jaxest.cli.methods.slam import MAP
    from jaxest.io.clouds import read_cloud
    from jaxest.io.report import Row, report, to_json

    if out.suffix.lower() not in (*animation.SUFFIXES, ".rrd"):
        raise bad_input(f"{out}: expected a name that ends in {', '.join(animation.SUFFIXES)} or .rrd")
    model = kinematics.load(robot)
    source, name = _parted(str(estimate))
    if cloud is None and (source / MAP).is_file():
        cloud = source / MAP
    log = io.to_si(io.read(source / "estimate.npz" if source.is_dir() else source))
    joints = _stream(log, name or next((kind for kind in ("joints", "slides") if kind in log.streams), None))
    stamps = np.arange(joints.time[0], joints.time[-1] + 1e-9, 1 / rate)
    if out.suffix.lower() == ".gif":
        stamps = stamps[:: max(1, -(-len(stamps) // LONGEST))]
    rows = np.clip(np.searchsorted(joints.time, stamps), 0, len(joints.time) - 1)
    q = configurations(model, log, joints, rows)
    other = None if beside is None else _beside(model, beside, stamps, config)
    with working(f"drawing {len(rows)} postures ..."):
        if out.suffix.lower() == ".rrd":
            from jaxest.viz import recording

            recording.write(
                out, model, joints.time[rows], q, frames=tuple(frame or ()), beside=other, overwrite=force,
                covariance=_covariance(model, log, joints, rows), points=read_cloud(cloud).point if cloud else None,
            )  # fmt: skip
        else:
            animation.draw(out, robot, q, beside=other, rate_hz=min(rate, 25.0), overwrite=force)
    if json:
        return Answer(to_json(report("show", [Row("postures", out.name, float(len(rows)), "1")])))
    console().print(f"wrote {out}: {len(rows)} postures of {joints.time[-1] - joints.time[0]:.1f} s", soft_wrap=True)
    return Answer()


def _parted(given: str) -> tuple[Path, str | None]:
    """Part LOG:STREAM; a file whose own name has a colon stays whole."""
    path, _, name = given.rpartition(":") if not Path(given).exists() else ("", "", "")
    return (Path(path), name) if path else (Path(given), None)


def _stream(log: Any, name: str | None) -> Any:
    """The stream of joint angles of that name, or the only one that names joints."""
    from jaxest.types import unknown_name

    if name is None:
        named = [key for key, item in log.streams.items() if item.names and item.unit == "rad" and item.value.ndim == 2]
        if len(named) != 1:
            found = f"{len(named)} streams of joint angles{': ' if named else ''}{', '.join(named)}"
            raise bad_input(f"{log.source}: {found}; expected one, or its name behind the file's: LOG:STREAM")
        name = named[0]
    if name not in log.streams:
        raise unknown_name("stream", name, log.streams)
    if not log.streams[name].names:
        raise bad_input(f"{log.source}: stream {name!r} does not name its joints")
    return log.streams[name]


def configurations(robot: Any, log: Any, joints: Any, rows: Any) -> Any:
    """Put joint angles, and where slides, ball and free joints are, into the robot's coordinates; others stay at home.

    Where an angle is not finite, the last one that is stands for it, or the first one that is; a note says so.

    Args:
        robot: the robot.
        log: the estimate, for streams `slides`, and `NAME/orientation` and `NAME/position` of joints, or of the free
            joints' bodies.
        joints: its stream of named angles, or of slides where there are no others.
        rows: (T,) which of its rows.

    Returns:
        (T, nq)
    """
    import jax
    import numpy as np

    from jaxest import kinematics
    from jaxest.io.log import finite_rows, where
    from jaxest.types import unknown_name

    q = np.tile(np.asarray(robot.home, float), (len(rows), 1))
    slides = log.streams.get("slides")
    beside = slides is not None and slides.names and len(slides.value) == len(joints.value)
    read = [joints, slides] if beside else [joints]
    for name, column in [pair for item in read for pair in zip(item.names, item.value.T, strict=True)]:
        if name not in robot.joint_names:
            raise unknown_name("joint", name, robot.joint_names)
        at = robot.topology.joint_q[robot.joint_names.index(name)]
        q[:, at] = _held(column, rows, q[:, at])
    tree = robot.topology
    for j, (name, kind) in enumerate(zip(robot.joint_names, tree.joint_kind, strict=True)):
        at = tree.joint_q[j]
        if kind == "ball":
            names, parts = [name], {"orientation": slice(at, at + 4)}
        elif kind == "free":
            names = [name, tree.body_names[tree.joint_body[j]]]
            parts = {"position": slice(at, at + 3), "orientation": slice(at + 3, at + 7)}
        else:
            continue
        for part, place in parts.items():
            found = next((log.streams[key] for key in (f"{n}/{part}" for n in names) if key in log.streams), None)
            if found is not None and len(found.value) == len(joints.value):
                q[:, place] = _held(found.value, rows, q[:, place])
    missing = int(np.sum(~finite_rows(joints.value)[rows]))
    if missing:
        note(
            f"{where(log)}{missing} of {len(rows)} postures lack a joint; it stays where it was known last, or at home"
        )
    free = np.array(robot.topology.free)
    return np.asarray(jax.vmap(lambda x: kinematics.expand(robot, x))(q[:, free]), float)


def _held(value: Any, rows: Any, otherwise: Any) -> Any:
    """Rows of a value; where they are not finite the last one before that is, or the first one; else `otherwise`."""
    import numpy as np

    from jaxest.io.log import finite_rows

    known = np.flatnonzero(finite_rows(value))
    if not len(known):
        return otherwise
    return value[known[np.maximum(np.searchsorted(known, rows, side="right") - 1, 0)]]


def _beside(robot: Any, given: str, stamps: Any, config: Path | None) -> Any:
    import numpy as np

    from jaxest import io
    from jaxest.cli import settings
    from jaxest.cli.truth import refuse_other_times

    path, name = _parted(given)
    log = io.to_si(io.read(path, settings.load(config).columns))
    joints = _stream(log, name)
    refuse_other_times(f"--beside {given}", joints, stamps)
    rows = np.clip(np.searchsorted(joints.time, stamps), 0, len(joints.time) - 1)
    return configurations(robot, log, joints, rows)


def _covariance(robot: Any, log: Any, joints: Any, rows: Any) -> Any:
    """The joints' covariance among the robot's velocities (T, nv, nv), 0 where nothing is known of it."""
    import numpy as np

    stream = log.streams.get("joints_covariance")
    if stream is None or len(stream.value) != len(joints.value):
        return None
    at = [robot.topology.joint_v[robot.joint_names.index(name)] for name in joints.names]
    whole = np.zeros((len(rows), robot.nv, robot.nv))
    whole[:, np.array(at)[:, None], np.array(at)[None, :]] = np.nan_to_num(stream.value[rows])
    return whole
