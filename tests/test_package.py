"""The wheel: built without a network, installed into an environment of its own, run from another folder."""

import os
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.test_tree import ROOT, tree

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


@dataclass(frozen=True)
class Installed:
    wheel: Path
    venv: Path
    elsewhere: Path

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Runs a command of the environment, away from the tree and with nothing of this process's Python."""
        env = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        return subprocess.run(
            [str(self.venv / "bin" / command[0]), *command[1:]],
            cwd=self.elsewhere,
            env=env,
            capture_output=True,
            text=True,
            timeout=120,
        )


def call(*command: object) -> None:
    ended = subprocess.run([str(part) for part in command], cwd=ROOT, capture_output=True, text=True, timeout=240)
    assert ended.returncode == 0, ended.stdout + ended.stderr


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    top = tmp_path_factory.mktemp("a wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    offline = ["--no-index", "--no-deps"]
    call(*pip, "wheel", *offline, "--no-build-isolation", "--wheel-dir", top, ROOT)
    (wheel,) = top.glob("*.whl")

    # The packages it depends on are those of this environment; the editable installation's path file isn't read there.
    venv = top / "an environment"
    call(sys.executable, "-m", "venv", "--without-pip", venv)
    (site,) = venv.glob("lib/python*/site-packages")
    paths = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "dependencies.pth").write_text("".join(f"{path}\n" for path in sorted(paths)), "utf-8")
    call(*pip, "--python", venv / "bin" / "python", "install", *offline, "--ignore-installed", wheel)

    elsewhere = top / "another folder"
    elsewhere.mkdir()
    return Installed(wheel, venv, elsewhere)


def test_the_wheel_holds_the_three_packages_and_nothing_else(installed: Installed) -> None:
    with zipfile.ZipFile(installed.wheel) as archive:
        names = archive.namelist()
    tops = {name.split("/")[0] for name in names}
    assert tops == {"app", "engine", "assets", f"wattlane-{PROJECT['version']}.dist-info"}
    assert not [name for name in names if "__pycache__" in name or name.endswith((".pyc", ".nbi", ".nbc"))]


def test_every_asset_is_in_the_wheel(installed: Installed) -> None:
    with zipfile.ZipFile(installed.wheel) as archive:
        shipped = set(archive.namelist())
    files = {path.relative_to(ROOT).as_posix() for path in tree()}
    assert {name for name in files if name.startswith("assets/")} <= shipped
    assert {name for name in files if name.startswith(("app/", "engine/"))} <= shipped


def test_the_command_runs_from_another_folder(installed: Installed) -> None:
    version = installed.run("wattlane", "--version")
    assert version.returncode == 0, version.stderr
    assert PROJECT["version"] in version.stdout

    shown = installed.run("wattlane", "--help")
    assert shown.returncode == 0, shown.stderr
    for command in ("dashboard", "run", "replay", "judge"):
        assert command in shown.stdout


def test_the_installed_packages_are_not_those_of_the_tree(installed: Installed) -> None:
    shown = installed.run(
        "python", "-c", "import app, assets, engine\nfor it in app, assets, engine: print(it.__file__)"
    )
    assert shown.returncode == 0, shown.stderr
    assert all(Path(line).is_relative_to(installed.venv) for line in shown.stdout.splitlines())


def test_the_assets_are_found_from_another_folder(installed: Installed) -> None:
    names = sorted(
        path.relative_to(ROOT / "assets").as_posix() for path in tree() if path.is_relative_to(ROOT / "assets")
    )
    program = (
        "import sys, assets\n"
        "missing = [name for name in sys.argv[1:] if not assets.path(*name.split('/')).is_file()]\n"
        "sys.exit(f'not found: {missing}' if missing else 0)"
    )
    looked = installed.run("python", "-c", program, *names)
    assert looked.returncode == 0, looked.stderr


def test_asset_paths_stay_inside_the_folder() -> None:
    import assets

    assert assets.path().is_dir()
    assert assets.path("web").is_relative_to(assets.path())
    with pytest.raises(ValueError, match="leads out of the assets folder"):
        assets.path("..", "pyproject.toml")
