"""Import rules between packages, and rules for files."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
FORBIDDEN_NAMES = {"utils", "util", "common", "core", "helpers", "helper", "misc"}
MAX_LINES = 400

OWN_BASE = ("children", "files", "limits", "locks", "memory", "settings", "torch_state")
TENSORS = {"torch", "tensordict", "numpy", "pydantic", *(f"fishrl.{name}" for name in OWN_BASE)}
#: Packages of the programs, which nothing in the library imports.
PROGRAMS = TENSORS | {
    *("torchrl", "hydra", "omegaconf", "yaml", "tqdm", "psutil", "matplotlib", "PIL", "scipy"),
    *("huggingface_hub", "minari", "gymnasium", "xarray", "pyvista", "fishrl"),
}
TASK_SIDE = {"fishrl.physics", "fishrl.envs"}
TORCHRL_FILES = tuple(
    f"fishrl/envs/{name}.py"
    for name in ("flow_env", "making", "episodes", "recognition", "specs", "transforms")
)
DRAWING = {"rerun", "psutil", "matplotlib", "PIL", "imageio_ffmpeg", "xarray", "pyvista"}
WRAPPED = {"torchrl", "gymnasium", "pettingzoo", "stable_baselines3", "minari"}
# The first matching prefix applies to a file; "a.b" allows "a.b" and "a.b.c".
LAYERS: tuple[tuple[str | tuple[str, ...], set[str]], ...] = (
    (tuple(f"fishrl/{name}.py" for name in ("__init__", "forks", "limits")), set()),
    (("fishrl/children.py", "fishrl/locks.py"), {"fishrl.forks"}),
    ("fishrl/figure_style.py", set()),
    ("fishrl/settings/", {"numpy", "pydantic", "pydantic_core", "fishrl.settings"}),
    ("fishrl/pages.py", {"fishrl.files"}),
    ("fishrl/presets/", {"yaml", "fishrl.settings", "fishrl.presets"}),
    ("fishrl/extras.py", {"packaging"}),
    (
        ("fishrl/files.py", "fishrl/memory.py", "fishrl/torch_state.py"),
        {"torch", "fishrl.limits", "fishrl.locks"},
    ),
    # bodies know nothing of flows
    ("fishrl/physics/bodies/", TENSORS | {"fishrl.physics.bodies", "fishrl.physics.lattice"}),
    ("fishrl/physics/", TENSORS | {"fishrl.physics"}),
    ("fishrl/envs/__init__.py", TASK_SIDE),
    ("fishrl/envs/scene.py", {"torch"}),
    ("fishrl/envs/one_hot.py", TENSORS | {"torchrl"}),
    ("fishrl/envs/making.py", TENSORS | {"torchrl", "fishrl.presets"} | TASK_SIDE),
    (TORCHRL_FILES, TENSORS | {"torchrl"} | TASK_SIDE),
    ("fishrl/envs/wakes.py", TENSORS | {"tqdm"} | TASK_SIDE),
    ("fishrl/envs/", TENSORS | TASK_SIDE),
    ("fishrl/wrappers/pictures.py", TENSORS | {"torchrl", "fishrl.viewer"} | TASK_SIDE),
    (
        "fishrl/wrappers/",
        TENSORS | WRAPPED | {f"fishrl.{n}" for n in ("extras", "presets", "wrappers")} | TASK_SIDE,
    ),
    ("fishrl/modules/", TENSORS | {"torchrl", "fishrl.modules"}),
    ("fishrl/objectives/", TENSORS | {"torchrl", "fishrl.objectives"}),
    ("fishrl/training/", TENSORS | {"torchrl", "tqdm", "yaml", "psutil", "wandb", "ray", "fishrl"}),
    ("fishrl/zoo/", TENSORS | {"huggingface_hub", "fishrl"}),
    ("fishrl/benchmark/", TENSORS | {"fishrl.benchmark", "fishrl.envs", "fishrl.training"}),
    ("fishrl/__main__.py", {"fishrl.programs"}),
    ("fishrl/programs/", PROGRAMS),
    (
        "fishrl/viewer/",
        TENSORS | {"torchrl", "fishrl.viewer", "fishrl.figure_style"} | DRAWING | TASK_SIDE,
    ),
)
TORCHRL_SIDE = {f"fishrl.envs.{Path(name).stem}" for name in TORCHRL_FILES}
#: Imports of own modules inside functions, for optional packages.
MAX_LATE_IMPORTS = 5
OWN = {"fishrl", "experiments"}
#: Packages, and the only files that may import them.
IMPORTERS: tuple[tuple[set[str], tuple[str, ...]], ...] = (
    ({"rerun"}, ("fishrl/viewer/",)),
    ({"fcntl"}, ("fishrl/locks.py",)),
    (
        WRAPPED - {"torchrl"} | {"sb3_contrib", "fishrl.wrappers"},
        ("fishrl/wrappers/", "fishrl/programs/export_data.py", "fishrl/programs/score.py"),
    ),
)


def _sources(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def _relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def _parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _imported_by(node: ast.AST, path: Path) -> list[str]:
    """Return the absolute names of an import statement."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        package = path.relative_to(ROOT).with_suffix("").parts
        start = ".".join(package[: len(package) - node.level]) if node.level else ""
        module = ".".join(part for part in (start, node.module) if part)
        return [f"{module}.{alias.name}" for alias in node.names]
    return []


def _is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")


def _names(path: Path) -> list[str]:
    return [name for node in ast.walk(_parse(path)) for name in _imported_by(node, path)]


def list_imports(*folders: str) -> set[str]:
    """Return the absolute names that the files of some folders import."""
    return {name for path in _sources(*folders) for name in _names(path)}


def list_attributes(*folders: str) -> set[str]:
    """Return the whole dotted names, such as ``torch.fx.Node``, that some folders use."""
    every = [node for path in _sources(*folders) for node in ast.walk(_parse(path))]
    inner = {id(node.value) for node in every if isinstance(node, ast.Attribute)}
    return {
        ast.unparse(node)
        for node in every
        if isinstance(node, ast.Attribute) and id(node) not in inner
    }


def _is_within(name: str, packages: set[str]) -> bool:
    return any(name == package or name.startswith(package + ".") for package in packages)


def test_library_files_obey_layers() -> None:
    for path in _sources("fishrl"):
        rules = [allowed for prefix, allowed in LAYERS if _relative(path).startswith(prefix)]
        assert rules, f"{_relative(path)} belongs to no layer: add it to LAYERS, or move it"
        allowed = rules[0] | set(sys.stdlib_module_names)
        wrong = [name for name in _names(path) if not _is_within(name, allowed)]
        assert not wrong, f"{_relative(path)} imports {wrong}; allowed: {sorted(rules[0])}"


def test_task_files_do_not_import_torchrl_indirectly() -> None:
    gates = {f"{name.rpartition('.')[2]}.py" for name in TORCHRL_SIDE} | {"__init__.py"}
    tasks = [path for path in _sources("fishrl/envs") if path.name not in gates]
    wrong = [_relative(path) for path in tasks for n in _names(path) if _is_within(n, TORCHRL_SIDE)]
    assert not wrong


def test_optional_packages_are_imported_by_few_files() -> None:
    for path in _sources("fishrl", "experiments"):
        file = _relative(path)
        for packages, importers in IMPORTERS:
            wrong = [name for name in _names(path) if _is_within(name, packages)]
            assert not wrong or file.startswith(importers), f"{file} imports {wrong}"


def test_files_are_short_and_have_specific_names() -> None:
    for path in _sources("fishrl", "experiments", "tests"):
        lines = len(path.read_text(encoding="utf-8").splitlines())
        assert lines <= MAX_LINES, f"{_relative(path)} has {lines} lines, {MAX_LINES} is the most"
        assert not set(path.relative_to(ROOT).with_suffix("").parts) & FORBIDDEN_NAMES


def test_files_are_written_through_staged() -> None:
    """Only locks and logs, which are appended to, are opened directly."""
    for path in _sources("fishrl", "experiments"):
        for call in (node for node in ast.walk(_parse(path)) if isinstance(node, ast.Call)):
            name = ast.unparse(call.func)
            words = [ast.unparse(word) for word in call.args]
            owner, _, method = name.rpartition(".")
            is_open = method == "open" and any(word[:2] in ("'w", "'x") for word in words)
            target = owner if is_open or method in ("write_text", "write_bytes") else ""
            if method in ("savefig", "copy", "copyfile") or name == "torch.save":
                target = words[-1] if words else ""
            assert target in ("", "stage", "part"), f"{_relative(path)}: {ast.unparse(call)}"


@cache
def _find_imports() -> tuple[dict[str, set[str]], list[str]]:
    """Return the imports of each own module, and those inside functions."""
    paths = {path: path.relative_to(ROOT).with_suffix("") for path in _sources(*OWN)}
    modules = {".".join(p.parts).removesuffix(".__init__"): path for path, p in paths.items()}
    edges: dict[str, set[str]] = {name: set() for name in modules}
    late = []
    for name, path in modules.items():
        tree = _parse(path)
        hidden = {id(n) for b in ast.walk(tree) if _is_type_checking(b) for n in ast.walk(b)}
        for node in ast.walk(tree):
            found = [] if id(node) in hidden else _imported_by(node, path)
            found += [word.rpartition(".")[0] for word in found]
            edges[name] |= set(found) & modules.keys() - {name}
            if node not in tree.body and any(_is_within(word, OWN) for word in found):
                late.append(f"{_relative(path)}:{node.lineno}")
    return edges, late


def test_no_import_cycles() -> None:
    """Cycles through a package's ``__init__``, which re-exports, are allowed."""
    edges, _ = _find_imports()

    def reach(start: str) -> set[str]:
        found, front = set[str](), {start}
        while front:
            front = set().union(*(edges[name] for name in front)) - found
            found |= front
        return found

    inits = {name for name in edges if (ROOT / name.replace(".", "/")).is_dir()}
    ways = {name: reach(name) for name in edges}
    circles = {
        frozenset(other for other in ways[name] if name in ways[other]) - inits for name in edges
    }
    assert not [sorted(circle) for circle in circles if len(circle) > 1]


def test_few_imports_inside_functions() -> None:
    _, late = _find_imports()
    assert len(late) <= MAX_LATE_IMPORTS, f"{len(late)} imports inside functions: {late}"


def test_physics_imports_without_optional_packages() -> None:
    blocked = ("torchrl", "hydra", "omegaconf", "rerun", "wandb", "matplotlib")
    script = f"import sys; sys.modules.update(dict.fromkeys({blocked!r})); import fishrl.physics"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
