# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes by name: files and those that are shipped."""

from itertools import takewhile
from pathlib import Path

from ..errors import InputError
from ..io.yamlfile import Section, read_yaml
from .contradictions import check_scene
from .schema import Scene
from .sections import parse_scene


def load_scene(scene):
    """Read and check a scene.

    Parameters
    ----------
    scene : str, Path or dict
        A YAML file, the name of a shipped scene, or the mapping that such a file would hold.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        For an unreadable file, an unknown key, a wrong type, a value out of range, or sections
        that contradict each other; the message names file, dotted key, rule and value.
    """
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, dict):
        return _checked(Section(scene, "scene"), None)
    path = _scene_path(scene)
    return _checked(Section(read_yaml(path), str(scene)), path)


def _checked(top, path):
    scene = parse_scene(top, path)
    check_scene(top, scene)
    return scene


def shipped_scenes():
    """Names of the scenes that are shipped, sorted."""
    return sorted(path.stem for path in _shipped_folder().glob("*.yaml"))


def about_scene(name):
    """What a scene shows: the comment that its file begins with, as one line."""
    lines = _scene_path(name).read_text(encoding="utf-8").splitlines()
    return " ".join(line.lstrip("# ") for line in takewhile(lambda x: x.startswith("#"), lines))


def _shipped_folder():
    from .._config import DATA_DIR

    return Path(DATA_DIR) / "scenes"


def _scene_path(scene):
    """The file meant: a shipped scene when the name has no suffix and no such file is there."""
    path = Path(scene)
    if path.is_file() or path.suffix:
        return path
    if str(scene) not in shipped_scenes():
        if path.exists():
            return path
        rule = f"must be a .yaml file or one of {', '.join(shipped_scenes())}"
        raise InputError("scene", rule, str(scene))
    return _shipped_folder() / f"{scene}.yaml"
