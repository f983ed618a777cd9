"""The files of the tree: nothing of the machine they were written on, and a lock that fits any machine."""

import os
import re
import subprocess
import tomllib
from functools import cache
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parent.parent
LOCKS = ["requirements.lock", "requirements-dev.lock"]

# Written in pieces, or this file would be the one that names them.
HOSTS = [
    ".".join(name)
    for name in [
        ("pypi", "org"),
        ("pythonhosted", "org"),
        ("npmjs", "org"),
        ("yarnpkg", "com"),
        ("deb", "debian", "org"),
        ("archive", "ubuntu", "com"),
        ("anaconda", "org"),
        ("crates", "io"),
        ("proxy", "golang", "org"),
        ("docker", "io"),
        ("ghcr", "io"),
        ("pkg", "dev"),
    ]
]
# A path from the top of a file system. What a container holds is named in the container's files.
CONTAINER_FILES = {"Dockerfile", "compose.yaml"}
ABSOLUTE = re.compile(
    r"(?<![\w.~/$})-])/(?:home|root|work|workspace|tmp|usr|opt|var|etc|mnt|srv|Users|private|proc|sys)/[\w.-]"
)
# A script's first line, and what a hostile request asks for, name files that every machine has.
EVERYWHERE = re.compile(r"#!/usr/bin/env |/etc/(?:passwd|shadow|hosts)")
WINDOWS = re.compile(r"\b[A-Za-z]:\\+(?:Users|Program|Windows|Temp)\b", re.IGNORECASE)


@cache
def tree() -> tuple[Path, ...]:
    """The files that are, or would be, committed."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if listed.returncode == 0:
        names = [name for name in listed.stdout.split("\0") if name]
        return tuple(path for name in sorted(names) if (path := ROOT / name).is_file())
    left_out = {".git", ".venv", "build", "dist", "__pycache__"}
    return tuple(
        path for path in sorted(ROOT.rglob("*")) if path.is_file() and not left_out & set(path.relative_to(ROOT).parts)
    )


@cache
def texts() -> dict[str, str]:
    """The text of each file that is text, by its path in the tree."""
    found = {}
    for path in tree():
        content = path.read_bytes()
        if b"\0" not in content[:8192]:
            found[path.relative_to(ROOT).as_posix()] = content.decode("utf-8", "replace")
    return found


def lines_with(pattern: re.Pattern[str], but_in: set[str] = frozenset()) -> list[str]:
    return [
        f"{name}:{number}: {line.strip()[:160]}"
        for name, text in texts().items()
        if name not in but_in and pattern.search(text)
        for number, line in enumerate(text.splitlines(), 1)
        if pattern.search(EVERYWHERE.sub("", line))
    ]


def test_no_file_names_a_package_registrys_host() -> None:
    assert lines_with(re.compile("|".join(re.escape(host) for host in HOSTS), re.IGNORECASE)) == []


def test_no_file_holds_an_absolute_path() -> None:
    assert lines_with(ABSOLUTE, but_in=CONTAINER_FILES) == []
    assert lines_with(WINDOWS) == []


def test_no_file_names_a_place_on_this_machine() -> None:
    places = {str(ROOT), str(Path.home()), os.environ.get("PYENV_ROOT", "")}
    long_enough = [re.escape(place) for place in places if len(place) > len("/root")]
    assert lines_with(re.compile("|".join(long_enough) or "(?!)")) == []


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ('open("|home|someone|run")', True),
        ("cd |tmp|x", True),
        ("DATA=|var|lib|wattlane", True),
        ("GET |runs|12|data|x", False),
        ("..|..|etc|passwd", False),
        ("assets|data|x", False),
    ],
)
def test_the_pattern_finds_absolute_paths(line: str, found: bool) -> None:
    assert bool(ABSOLUTE.search(line.replace("|", "/"))) is found


def test_scripts_have_a_portable_first_line() -> None:
    """`env` is where every system has it: the one absolute path that a script needs."""
    wrong = [
        f"{name}: {first}"
        for name, text in texts().items()
        if (first := text.partition("\n")[0]).startswith("#!") and not re.fullmatch(r"#!/usr/bin/env \w+", first)
    ]
    assert wrong == []


def pins(lock: str) -> dict[str, tuple[Version, int]]:
    """What a lock pins: name → version, number of hashes."""
    found = {}
    for entry in re.sub(r"\\\n", " ", (ROOT / lock).read_text("utf-8")).splitlines():
        if entry and not entry.startswith("#"):
            name, version, rest = re.fullmatch(r"([\w.-]+)==([^\s;]+)(.*)", entry).groups()
            found[canonicalize_name(name)] = Version(version), rest.count("--hash=sha256:")
    return found


@pytest.mark.parametrize("lock", LOCKS)
def test_a_lock_has_exact_versions_with_hashes_and_no_address(lock: str) -> None:
    text = (ROOT / lock).read_text("utf-8")
    assert not re.search(r"://|index-url|find-links|trusted-host|@ ", text)
    assert len(pins(lock)) > 20
    assert [name for name, (_, hashes) in pins(lock).items() if hashes == 0] == []


def test_the_locks_agree() -> None:
    less, more = (pins(lock) for lock in LOCKS)
    assert {name: pin for name, pin in less.items() if more.get(name) != pin} == {}


def test_the_locks_hold_what_the_project_asks_for() -> None:
    asked = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    running = [*asked["project"]["dependencies"], *asked["build-system"]["requires"]]
    developing = [line for extra in asked["project"]["optional-dependencies"].values() for line in extra]
    for lines, lock in [(running, LOCKS[0]), (running + developing, LOCKS[1])]:
        held = pins(lock)
        for line in lines:
            wanted = Requirement(line)
            version, _ = held[canonicalize_name(wanted.name)]
            assert version in wanted.specifier, f"{lock} pins {wanted.name} {version}; {line} is asked for: make lock"


def test_the_tree_is_laid_out_as_agreed() -> None:
    names = {path.relative_to(ROOT).parts[0] for path in tree()}
    assert {"app", "engine", "assets", "tests", "pyproject.toml", "Dockerfile", "compose.yaml", "LICENSE"} <= names
