"""The catalogue of recorded runs below one folder: names, list, rename, delete."""

from __future__ import annotations

import os
import re
import secrets
import shutil
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from engine.errors import BadInput, RunError
from engine.results.runlog import MANIFEST, LogReader, disk_errors, read_manifest, write_manifest, writer_alive

_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,119}")
NAME_LIMIT = 120


def run_id_for(scenario: str, created: datetime) -> str:
    """A new id such as `20261122-101500-soochow2022-1a2b`: when, what, and four random hex digits."""
    word = re.sub(r"[^a-z0-9]+", "-", scenario.lower()).strip("-")[:60] or "run"
    return f"{created:%Y%m%d-%H%M%S}-{word}-{secrets.token_hex(2)}"


def checked_id(run_id: object) -> str:
    """The id itself when it may name a run folder; raises BadInput for anything that could leave the runs' folder."""
    if not isinstance(run_id, str) or not _ID.fullmatch(run_id) or ".." in run_id:
        raise BadInput(f"{str(run_id)[:80]!r} is not a run id; one looks like 20261122-101500-soochow2022-1a2b")
    return run_id


def checked_name(name: object) -> str:
    """A person's label for a run, trimmed; raises BadInput when it is too long or holds control characters."""
    text = name.strip() if isinstance(name, str) else None
    if text is None or len(text) > NAME_LIMIT or any(not c.isprintable() for c in text):
        raise BadInput(f"a name of at most {NAME_LIMIT} printable characters was expected; got {str(name)[:80]!r}")
    return text


@dataclass(frozen=True, slots=True)
class Catalogue:
    """Runs below `root`, one folder each. Manifests are read once and again when they change."""

    root: Path
    _cache: dict[str, tuple[tuple[int, int], dict[str, Any]]] = field(default_factory=dict, repr=False, compare=False)
    _sizes: dict[str, tuple[int, int]] = field(default_factory=dict, repr=False, compare=False)

    def new_folder(self, scenario: str, created: datetime) -> Path:
        """Create the folder of a new run; its name is the run id. `created` is in UTC."""
        with disk_errors(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
            while True:
                folder = self.root / run_id_for(scenario, created)
                try:
                    folder.mkdir()
                except FileExistsError:
                    continue
                return folder

    def path(self, run_id: str) -> Path:
        """The run's folder; raises BadInput for a malformed id and RunError when there is no such run."""
        folder = self.root / checked_id(run_id)
        if not (folder / MANIFEST).is_file():
            raise RunError(f"there is no run {run_id}")
        return folder

    def get(self, run_id: str) -> dict[str, Any]:
        """The manifest, with `status` "interrupted" when the writer died, `alive` and `size_bytes`."""
        folder = self.path(run_id)
        stat = (folder / MANIFEST).stat()
        key = (stat.st_mtime_ns, stat.st_size)
        cached = self._cache.get(run_id)
        if cached is None or cached[0] != key:
            cached = (key, read_manifest(folder))
            self._cache[run_id] = cached
        alive = writer_alive(folder)
        out = {**cached[1], "run_id": run_id, "alive": alive}
        if out.get("status") == "running" and not alive:
            out["status"] = "interrupted"
        out["size_bytes"] = self._size(run_id, folder, key[0], alive)
        return out

    def list(self) -> list[dict[str, Any]]:
        """Every readable run as get() shows it, newest first. Folders that hold no run are left out."""
        found = []
        try:
            entries = sorted((e.name for e in os.scandir(self.root) if e.is_dir()), reverse=True)
        except FileNotFoundError:
            return []
        except OSError as error:
            raise RunError(f"the folder of runs {self.root} can't be read: {error.strerror}") from error
        for name in entries:
            try:
                found.append(self.get(name))
            except (BadInput, RunError):
                continue
        return sorted(found, key=lambda run: str(run.get("created", "")), reverse=True)

    def rename(self, run_id: str, name: str) -> dict[str, Any]:
        """Give a run a label of its own (empty takes it away); the id stays."""
        folder, label = self.path(run_id), checked_name(name)
        write_manifest(folder, {**read_manifest(folder), "name": label})
        return self.get(run_id)

    def delete(self, run_id: str) -> None:
        """Remove a run's folder; refused while its writer lives."""
        folder = self.path(run_id)
        if writer_alive(folder):
            raise RunError(f"run {run_id} is being written; stop it before deleting it")
        if folder.is_symlink():
            raise RunError(f"run {run_id} is a link; remove it by hand")
        with disk_errors(folder):
            (folder / MANIFEST).unlink()  # first: what is left of a failed removal is no run
            shutil.rmtree(folder)
        self._cache.pop(run_id, None)
        self._sizes.pop(run_id, None)

    def reader(self, run_id: str) -> LogReader:
        """A reader of the run's log."""
        return LogReader(self.path(run_id))

    def _size(self, run_id: str, folder: Path, stamp: int, alive: bool) -> int:
        known = self._sizes.get(run_id)
        if known is not None and known[0] == stamp and not alive:
            return known[1]
        size = 0
        for base, _, files in os.walk(folder):
            for name in files:
                try:
                    size += os.lstat(os.path.join(base, name)).st_size
                except FileNotFoundError:
                    continue
        self._sizes[run_id] = (stamp, size)
        return size
