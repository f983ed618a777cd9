#!/usr/bin/env bash
# Writes requirements.lock (the program, and what builds it) and requirements-dev.lock (and everything else): exact
# versions with the hashes of every platform's wheels, and no index address. Pins that still fit are kept;
# `make lock ARGS=--upgrade` takes the newest, `ARGS="--upgrade-package NAME"` the newest of one.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

tools=$(mktemp -d)
trap 'rm -rf "$tools"' EXIT
python=.venv/bin/python
[ -x "$python" ] || python=python3
"$python" -m venv "$tools/venv"
"$tools/venv/bin/python" -m pip install --quiet --disable-pip-version-check uv

# Nothing of this machine's configuration may show in the lock.
compile() {
  env -u UV_INDEX -u UV_EXTRA_INDEX_URL -u UV_FIND_LINKS -u UV_CONSTRAINT -u UV_OVERRIDE \
    "$tools/venv/bin/uv" --quiet --no-config pip compile --universal --python-version 3.11 --fork-strategy fewest \
    --only-binary :all: --generate-hashes --no-emit-index-url --no-emit-find-links --no-annotate \
    --custom-compile-command "make lock" "$@"
}
compile pyproject.toml --all-extras --group build --output-file requirements-dev.lock "$@"
compile pyproject.toml --group build --constraint requirements-dev.lock --output-file requirements.lock --upgrade
