"""What is wrong with a URDF in words: MuJoCo names neither a missing link nor a circle, and lets some faults pass."""

import re
from xml.etree import ElementTree

from jaxest.types import InputError, unknown_name


def check_text(name: str, text: str) -> None:
    """Refuse what is not a robot, and macros that nobody has expanded.

    Args:
        name: of the file, for messages.
        text: MJCF or URDF.

    Raises:
        InputError: the text is neither, is not UTF-8, or still holds macros.
    """
    if "\0" in text:
        raise InputError(f"{name}: not a text in UTF-8; expected MJCF or URDF saved as UTF-8")
    if not re.search(r"<(mujoco|robot)\b", text):
        found = text.strip().splitlines()[0][:60] if text.strip() else "an empty file"
        raise InputError(f"{name}: not a robot: expected MJCF (<mujoco>) or URDF (<robot>), found {found!r}")
    bare = without_comments(text)
    macro = re.search(r"<xacro:\w+", bare) or re.search(r"""=\s*["'][^"'<>]*?(\$[{(][^"'<>]*[})])""", bare)
    if macro:  # MuJoCo would leave an element out without a word
        found = macro[1] if macro.groups() else f"{macro[0]}>"
        raise InputError(f"{name}: found {found}, expected plain URDF; expand it first: xacro FILE > robot.urdf")


def check_urdf(name: str, text: str) -> None:
    """Refuse a URDF with a name twice, links or joints that do not exist, reversed limits, or links that form no tree.

    Args:
        name: of the file, for messages.
        text: MJCF, which passes, or URDF.

    Raises:
        InputError: with the joint or link at fault.
    """
    bare = without_comments(text)
    if "<robot" not in bare:
        return
    try:
        root = ElementTree.fromstring(re.sub(r"^\s*<\?xml.*?\?>", "", bare))
    except ElementTree.ParseError as error:  # MuJoCo's own parser lets more pass
        raise InputError(f"{name}: not well-formed XML ({error}); expected MJCF or URDF") from None
    links = [str(link.get("name")) for link in root.findall("link")]
    joints = root.findall("joint")
    names = [str(joint.get("name")) for joint in joints]
    for kind, given in (("link", links), ("joint", names)):
        twice = next((one for at, one in enumerate(given) if one in given[:at]), None)
        if twice is not None:  # MuJoCo names no link
            raise InputError(f"{name}: two {kind}s are named {twice!r}; expected each name once")
    parents: dict[str, str] = {}
    for joint in joints:
        place = f"{name}: joint {joint.get('name')!r}"
        for mimic in joint.iter("mimic"):
            leader = str(mimic.get("joint"))
            if leader not in names:  # MuJoCo would let it move freely without a word
                raise InputError(f"{place} mimics: {unknown_name('joint', leader, names)}")
        _check_limit(place, joint)
        ends = []
        for end in ("parent", "child"):
            found = joint.find(end)
            if found is None:
                raise InputError(f"{place}: no <{end} link=...>")
            ends.append(str(found.get("link")))
            if ends[-1] not in links:
                raise InputError(f"{place}: {end}: {unknown_name('link', ends[-1], links)}")
        parent, child = ends
        if child in parents:
            raise InputError(f"{place}: link {child!r} hangs on {parents[child]!r} already; expected a tree")
        parents[child] = parent
    _check_tree(name, links, parents)


def _check_limit(place: str, joint: ElementTree.Element) -> None:
    """Refuse a lower limit above the upper one, which MuJoCo would take for none."""
    limit = joint.find("limit")
    if limit is None or joint.get("type") not in ("revolute", "prismatic"):
        return
    try:
        low, high = (float(limit.get(end, 0)) for end in ("lower", "upper"))
    except ValueError:  # MuJoCo says so, with the line
        return
    if low > high:
        raise InputError(f"{place}: limit: lower {low:g} is above upper {high:g}; expected lower < upper")


def _check_tree(name: str, links: list[str], parents: dict[str, str]) -> None:
    for link in links:
        seen = [link]
        while seen[-1] in parents:
            seen.append(parents[seen[-1]])
            if seen[-1] in seen[:-1]:
                circle = " - ".join(seen[seen.index(seen[-1]) :])
                raise InputError(f"{name}: links form a circle: {circle}; expected a tree")


def without_comments(text: str) -> str:
    """Leave out XML comments, which may hold anything: many files have dashes there that strict parsers refuse."""
    return re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)


__all__ = ["check_text", "check_urdf", "without_comments"]
