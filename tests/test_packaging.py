"""The wheel: the whole typed library and nothing else."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from email import message_from_bytes
from email.message import Message
from pathlib import Path

import pytest
from omegaconf import OmegaConf
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import fishrl

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build a wheel from a copy of the sources and unpack it."""
    source = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in ("fishrl", "experiments", "tests"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    build = "from setuptools.build_meta import build_wheel; build_wheel('dist')"
    subprocess.run([sys.executable, "-c", build], cwd=source, check=True, stdout=subprocess.DEVNULL)
    (path,) = (source / "dist").glob("*.whl")
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    return folder


def _read_metadata(installed: Path) -> Message:
    (path,) = installed.glob("*.dist-info/METADATA")
    return message_from_bytes(path.read_bytes())


def _list_files(root: Path, pattern: str) -> set[str]:
    files = {path.relative_to(root).as_posix() for path in root.glob(pattern) if path.is_file()}
    return {file for file in files if "__pycache__" not in file and ".dist-info" not in file}


def test_wheel_holds_exactly_the_library(installed: Path) -> None:
    packed = _list_files(installed, "**/*")
    assert packed == _list_files(ROOT, "fishrl/**/*")
    assert {"fishrl/py.typed", "fishrl/envs/steering.pt"} <= packed


def test_versions_of_wheel_citation_and_changelog_agree(installed: Path) -> None:
    metadata = _read_metadata(installed)
    assert metadata["Version"] == fishrl.__version__
    assert metadata["License-Expression"] == "MIT"
    assert list(installed.glob("*.dist-info/licenses/LICENSE"))
    citation = OmegaConf.to_container(OmegaConf.load(ROOT / "CITATION.cff"))
    assert isinstance(citation, dict)
    needed = {"cff-version", "message", "title", "authors", "version", "license", "type"}
    assert needed <= set(citation)
    assert str(citation["version"]) == fishrl.__version__
    assert all("name" in author or "family-names" in author for author in citation["authors"])
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## [{fishrl.__version__}]" in changelog and "## [Unreleased]" in changelog


def test_extras_named_by_errors_exist(installed: Path) -> None:
    files = [path for name in ("fishrl", "experiments") for path in (ROOT / name).rglob("*.py")]
    text = "".join(path.read_text(encoding="utf-8") for path in files)
    named = set(re.findall(r"""(?:show_install|needing)\(["']([\w-]+)""", text))
    assert len(named) > 3 and named <= set(_read_metadata(installed).get_all("Provides-Extra"))


def test_wheel_works_without_repository(installed: Path, tmp_path: Path) -> None:
    script = """
import sys, fishrl.physics, fishrl.envs, fishrl.modules, fishrl.objectives, fishrl.viewer
from fishrl.envs import Flows, Predation, make_env
from fishrl.envs.steering import PolicySteering
print(fishrl.__file__)
steering = PolicySteering()
env = make_env(task=Predation(
    body_length=16, levels=1, reynolds=500.0, max_wall_speed=0.15, wall_margin_bl=0.18,
    domain_bl=(5.0, 3.0), start_x_bl=(2.5, 3.5), food_x_bl=1.0, food_y_bl=1.5,
    food_limits_bl=(1.0, 2.0)), flows=Flows(num_envs=1, compile=False))
print(env.rollout(1)["next", "observation_stack"].isfinite().all().item())
print([name for name in sys.modules if name.split(".")[0] in ("experiments", "hydra", "rerun")])
"""
    command, env = [sys.executable, "-P", "-c", script], os.environ | {"PYTHONPATH": str(installed)}
    said = subprocess.check_output(command, cwd=tmp_path, env=env, text=True)
    assert said.split() == [str(installed / "fishrl" / "__init__.py"), "True", "[]"]


def test_every_requirement_has_a_pinned_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    asked = [*project["dependencies"], *(line for lines in extras.values() for line in lines)]
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = [line for line in lines if "==" in line]
    names, known = ({canonicalize_name(Requirement(x).name) for x in y} for y in (asked, pinned))
    assert names <= known | {"fishrl"}
