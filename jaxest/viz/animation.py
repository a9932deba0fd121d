"""A robot that moves as it was estimated, rendered by MuJoCo off screen: a GIF, or one picture."""

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.files import replacing
from jaxest.io.extras import need
from jaxest.types import InputError

SUFFIXES = (".gif", ".png")
GHOST = (0.82, 0.29, 0.36, 0.35)
"""Colour of the robot beside it."""
_SKY, _STICK = (0.97, 0.98, 1.0), (0.55, 0.6, 0.68, 1.0)


def choose_renderer() -> None:
    """Have MuJoCo render without a display where there is none; has to come before `import mujoco`."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        os.environ.setdefault("MUJOCO_GL", "egl")


def draw(
    path: Path | str,
    source: str | Path,
    q: NDArray[np.float64],
    *,
    beside: NDArray[np.float64] | None = None,
    rate_hz: float = 20.0,
    size: tuple[int, int] = (480, 360),
    overwrite: bool = False,
) -> None:
    """Render a motion and write it.

    Args:
        path: ends in `.gif` (all postures), or `.png` (the last one).
        source: the robot's file, MJCF or URDF, or its text.
        q: (T, nq) its coordinates, one row a picture.
        beside: (T, nq) of a second one, drawn through it in red: the robot as a rigid model would have it.
        rate_hz: pictures a second.
        size: pixels, width and height.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: another suffix, no robot, the output exists, Pillow is not installed, or MuJoCo cannot render here;
            the message says what to set.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: expected a name that ends in {' or '.join(SUFFIXES)}")
    image = need("PIL.Image", "viz", path)
    rows = slice(None) if path.suffix.lower() == ".gif" else slice(-1, None)
    pictures = [image.fromarray(one) for one in frames(source, q[rows], None if beside is None else beside[rows], size)]
    with replacing(path, overwrite) as file:
        if path.suffix.lower() == ".png":
            pictures[-1].save(file, "PNG")
            return
        small = [picture.quantize(64) for picture in pictures]
        small[0].save(file, "GIF", save_all=True, append_images=small[1:], duration=1000 / rate_hz, loop=0)


def frames(
    source: str | Path, q: NDArray[np.float64], beside: NDArray[np.float64] | None, size: tuple[int, int]
) -> Iterator[NDArray[np.uint8]]:
    """Yield a picture (height, width, 3) for each row of coordinates; see `draw`."""
    choose_renderer()
    import mujoco

    model = _visible(source)
    if np.shape(q)[1] != model.nq:
        raise InputError(f"q: {np.shape(q)[1]} coordinates, expected {model.nq} as the robot has")
    try:
        renderer = mujoco.Renderer(model, size[1], size[0])
    except Exception as error:  # each of MuJoCo's backends has its own
        raise InputError(
            f"MuJoCo cannot render here ({error}); set MUJOCO_GL=egl (a GPU or Mesa) or MUJOCO_GL=osmesa before Python "
            "starts, or write a Rerun recording (.rrd)"
        ) from error
    data, other, option = mujoco.MjData(model), mujoco.MjData(model), mujoco.MjvOption()
    option.sitegroup[:] = 0
    option.geomgroup[:] |= _hidden(model)
    camera = _camera(model, np.concatenate([q, *([] if beside is None else [beside])]))
    with renderer:
        for i, row in enumerate(q):
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, camera, option)
            _sticks(renderer.scene, model, data, _STICK)
            if beside is not None:
                other.qpos[:] = beside[i]
                mujoco.mj_kinematics(model, other)
                before = renderer.scene.ngeom
                mujoco.mjv_addGeoms(
                    model, other, option, mujoco.MjvPerturb(), mujoco.mjtCatBit.mjCAT_DYNAMIC, renderer.scene
                )
                _sticks(renderer.scene, model, other, GHOST)
                for geom in renderer.scene.geoms[before : renderer.scene.ngeom]:
                    geom.rgba[:] = GHOST
            yield renderer.render()


def _visible(source: str | Path) -> Any:
    """Compile the robot with its shapes, or without those whose files are absent, under a bright sky."""
    import mujoco

    from jaxest.kinematics.load import compile_model

    compiled = compile_model(source)  # says what is wrong with a file
    text = _with_shapes(str(source))
    try:
        spec = mujoco.MjSpec.from_string(text) if text.lstrip().startswith("<") else mujoco.MjSpec.from_file(text)
        spec.compiler.discardvisual = False  # in a URDF it is set, and takes the sky as well
        spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9  # a link without inertia can be drawn
        for texture in [t for t in spec.textures if t.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX]:
            spec.delete(texture)
        spec.add_texture(
            name="jaxest_sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
            rgb1=_SKY, rgb2=_SKY, width=32, height=192,
        )  # fmt: skip
        return spec.compile()
    except ValueError:
        return compiled


def _with_shapes(source: str) -> str:
    """Return the text of a URDF that keeps its visual shapes, which MuJoCo leaves out; anything else as it is."""
    urdf = source.lower().endswith(".urdf")
    text = Path(source).read_text(encoding="utf-8", errors="replace") if urdf else source
    if "</robot>" not in text or "<mesh" in text or "<mujoco" in text:
        return source
    text = re.sub(r"^\s*<\?xml.*?\?>", "", text)  # MuJoCo takes no declared encoding with a string
    return text.replace("</robot>", '<mujoco><compiler discardvisual="false" fusestatic="false"/></mujoco></robot>')


def _hidden(model: Any) -> bool:
    """Say whether all shapes of the robot are in groups that MuJoCo does not draw, such as that of collisions."""
    import mujoco

    drawn = mujoco.MjvOption().geomgroup[model.geom_group] != 0
    return not np.any(drawn[model.geom_bodyid > 0])


def _camera(model: Any, q: NDArray[np.float64]) -> Any:
    """Look at all that the robot does, from in front and above."""
    import mujoco

    data, places = mujoco.MjData(model), []
    for row in q[:: max(1, len(q) // 50)]:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        places.append(np.vstack([data.xpos[1:], data.geom_xpos[model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE]]))
    low, high = np.min(np.vstack(places), axis=0), np.max(np.vstack(places), axis=0)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (low + high) / 2
    camera.distance = 1.3 * max(float(np.linalg.norm(high - low)), 0.1) + 0.1
    camera.azimuth, camera.elevation = 130.0, -18.0
    return camera


def _sticks(scene: Any, model: Any, data: Any, colour: tuple[float, ...]) -> None:
    """Draw lines from body to body where a robot has no shapes."""
    import mujoco

    if np.any(model.geom_bodyid > 0):
        return
    radius = 0.012 * float(model.stat.extent)
    for body in range(2, model.nbody):
        start, end = data.xpos[model.body_parentid[body]], data.xpos[body]
        if scene.ngeom >= scene.maxgeom or np.allclose(start, end):
            continue
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(
            geom, mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), np.zeros(9), np.array(colour, np.float32)
        )
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, start, end)
        scene.ngeom += 1


__all__ = ["GHOST", "SUFFIXES", "choose_renderer", "draw", "frames"]
