"""The direction of the imports, and the few rules that every file of the package keeps."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "jaxlocomanip"
NAME = PACKAGE.name
FILES = sorted(PACKAGE.rglob("*.py"))
VIEWERS = {"mujoco", "rerun", "matplotlib"}
OUTSIDE_CORE = (
    "worlds.scene",
    "worlds.scene_robots",
    "worlds.scene_shapes",
    "worlds.physics_c",
    "worlds.physics_mjx",
    "worlds.quadruped",
    "worlds.quadruped_c",
    "worlds.quadruped_mjx",
    "worlds.quadruped_team",
    "worlds.legged",
    "recording",
    "commands",
    "cli",
)

every_file = pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))


def module_of(path):
    """Dotted name of a file below the package: `planner.search`, or nothing for its own __init__."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(p for p in parts if p != "__init__")


def imports_of(path):
    """Absolute names of everything a file imports, at its top or inside functions."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def within(module, rooms):
    return any(module == room or module.startswith(f"{room}.") for room in rooms)


def rooms_used(path):
    """Modules of the package that a file imports, without the package's name."""
    return {name.removeprefix(f"{NAME}.") for name in imports_of(path) if name.startswith(f"{NAME}.")}


def files_in(*rooms):
    chosen = [p for p in FILES if within(module_of(p), rooms)]
    assert chosen, f"no file in {rooms}"
    return chosen


@pytest.mark.parametrize(
    ("room", "allowed"),
    [
        ("numerics", ()),
        ("solver", ("numerics", "solver")),
        ("planar", ("numerics", "planar")),
    ],
)
def test_rooms_that_import_only(room, allowed):
    for path in files_in(room):
        strangers = {name for name in rooms_used(path) if not within(name, allowed)}
        assert not strangers, f"{path.name} imports {sorted(strangers)}"
        assert NAME not in imports_of(path), f"{path.name} imports the whole package"


@pytest.mark.parametrize(
    ("room", "refused"),
    [
        ("planner", ("closed_loop", "outcome", "worlds", "sampling", "sweep", "recording", "commands", "cli")),
        (
            "worlds",
            ("planner", "solver", "closed_loop", "outcome", "sampling", "sweep", "recording", "commands", "cli"),
        ),
        ("closed_loop", ("batch", "sampling", "sweep", "recording", "commands", "cli")),
        ("sampling", ("planner", "solver", "worlds", "closed_loop", "batch", "sweep", "recording", "commands", "cli")),
        ("batch", ("sampling", "sweep", "recording", "commands", "cli")),
    ],
)
def test_rooms_that_never_import(room, refused):
    for path in files_in(room):
        wrong = {name for name in rooms_used(path) if within(name, refused)}
        assert not wrong, f"{path.name} imports {sorted(wrong)}"


def test_nothing_sees_recording_and_cli():
    for path in FILES:
        if not within(module_of(path), ("recording", "commands", "cli", "__main__")):
            assert not {n for n in rooms_used(path) if within(n, ("recording", "commands", "cli"))}, path.name


def test_core_needs_no_viewer_and_no_physics_engine():
    for path in FILES:
        if not within(module_of(path), OUTSIDE_CORE):
            heavy = {name.partition(".")[0] for name in imports_of(path)} & VIEWERS
            assert not heavy, f"{path.name} imports {sorted(heavy)}"


def test_only_the_cli_changes_the_settings_of_jax():
    for path in FILES:
        if within(module_of(path), ("cli",)):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and node.attr == "update":
                owner = ast.unparse(node.value)
                assert owner != "config" and not owner.endswith("jax.config"), f"{path.name}:{node.lineno}"


@every_file
def test_public_names_have_docstrings(path):
    """Modules, public classes and functions, and the public methods of public classes."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    if tree.body:
        assert ast.get_docstring(tree), "no module docstring"
    bare = []

    def visit(body, prefix):
        for node in body:
            named = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
            if not named or node.name.startswith("_"):
                continue
            if not ast.get_docstring(node):
                bare.append(prefix + node.name)
            if isinstance(node, ast.ClassDef):
                visit(node.body, f"{prefix}{node.name}.")

    visit(tree.body, "")
    assert not bare, f"without docstring: {bare}"
