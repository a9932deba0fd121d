"""What the text of a robot file asks MuJoCo to read or to multiply, looked at before MuJoCo does it."""

import math
import re
from pathlib import Path

from jaxest.kinematics.urdf import without_comments
from jaxest.types import InputError

MOST = 20_000
"""Copies of a body, nested copies multiplied; MuJoCo takes minutes and gigabytes for a million."""
_INCLUDE = re.compile(r"""<(?:include|model)\s[^>]*?\bfile\s*=\s*(["'])(.*?)\1""", re.DOTALL)
_COPIES = re.compile(r"""<(?:replicate|composite|flexcomp)\s[^>]*?\bcount\s*=\s*(["'])([\d\s]*)\1""", re.DOTALL)


def check_includes(name: str, text: str, folder: Path) -> tuple[list[str], list[Path]]:
    """Refuse includes and attached models that are no regular files, and numbers of copies that no robot has.

    Looks into all files included. MuJoCo would wait at a pipe and read a device without end. Files outside the robot's
    folder are read, as many robots share parts in that way, and said.

    Args:
        name: of the file, for messages.
        text: MJCF or URDF.
        folder: what its paths are relative to.

    Returns:
        Notes on files that lie outside the folder, and the folders of all of them.

    Raises:
        InputError: with the include or number at fault.
    """
    notes, waiting, seen = [], [(name, text, folder)], set[Path]()
    folders: dict[Path, None] = {}
    while waiting:
        place, part, base = waiting.pop()
        bare = without_comments(part)
        copies = [math.prod(int(n[:20]) for n in found[2].split()) for found in _COPIES.finditer(bare)]
        if math.prod(copies) > MOST:
            raise InputError(f"{place}: asks for {math.prod(copies):.3g} copies of its parts, expected at most {MOST}")
        for found in _INCLUDE.finditer(bare):
            path = base / found[2]
            if not _regular(path) or path.resolve() in seen:
                if path.exists() and not path.is_file():
                    raise InputError(f"{place}: includes {found[2]!r}, which is no file; expected MJCF")
                continue  # what is absent or comes twice MuJoCo says itself
            seen.add(path.resolve())
            if not path.resolve().is_relative_to(folder.resolve()):
                notes.append(f"reads {found[2]} from outside its folder")
            folders[path.parent] = None
            # What a model includes is relative to it, what an included text includes to the file that it ends up in.
            inner = path.parent if found[0].startswith("<model") else base
            waiting.append((f"{place}: {found[2]}", path.read_text(encoding="utf-8", errors="replace"), inner))
    return notes, list(folders)


def _regular(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        return False


__all__ = ["MOST", "check_includes"]
