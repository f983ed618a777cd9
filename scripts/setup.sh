#!/usr/bin/env bash
# Sets up what a make target needs, once: what the system lacks, and .venv from the lock.
#   setup.sh run    what the program needs
#   setup.sh lint   and the linters and the test packages
#   setup.sh test   and a browser for the browser tests
# A second call finds its stamps and returns at once; a changed lock, Python or folder sets up anew.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

case "${1:-}" in
  run | lint | test) goal=$1 ;;
  *) sed -n '2,6s/^# //p' "$0"; exit 2 ;;
esac
py=.venv/bin/python

say() { printf 'setup: %s\n' "$*"; }
stop() { printf 'setup: %s\n' "$@" >&2; exit 1; }

# --- the system -------------------------------------------------------------------------------------------------------

new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; }

# The first Python that runs and is new enough; PYTHON=... asks for one by name.
find_python() {
  local candidate
  if [ -n "${PYTHON:-}" ]; then
    new_enough "$PYTHON" || stop "PYTHON=$PYTHON does not run, or is older than Python 3.11."
    printf '%s\n' "$PYTHON"
    return
  fi
  for candidate in python3 python3.13 python3.12 python3.11 python3.14; do
    if new_enough "$candidate"; then
      printf '%s\n' "$candidate"
      return
    fi
  done
  stop "no Python of version 3.11 or newer was found; name one with: make PYTHON=path-to-python $goal"
}

# A usable environment of this very folder: one that was moved here points to where it was.
venv_stands() {
  [ -x "$py" ] && new_enough "$py" && "$py" -c 'import pip' 2>/dev/null && grep -qF "$(pwd -P)/.venv" .venv/bin/activate
}

# A snap's Chromium can't see the folders that Playwright makes for it, so it doesn't count.
browser_runs() {
  local name found
  for name in ${WATTLANE_CHROMIUM:+"$WATTLANE_CHROMIUM"} chromium google-chrome google-chrome-stable; do
    found=$(command -v "$name") && [[ $found != /snap/* ]] && "$name" --version >/dev/null 2>&1 && return
  done
  return 1
}

# apt_install PACKAGE... : where that is allowed; else says the command that does it, and stops.
apt_install() {
  local become=() log command="apt-get update && apt-get install -y $*"
  command -v apt-get >/dev/null ||
    stop "this system lacks something, and has no apt-get. Install what these Debian packages hold, then try again: $*"
  if [ "$(id -u)" -ne 0 ]; then
    if ! command -v sudo >/dev/null; then
      stop "this system lacks something. Install it with this command, then try again:" "  su -c '$command'"
    fi
    sudo -n true 2>/dev/null ||
      stop "this system lacks something. Install it with this command, then try again:" "  sudo sh -c '$command'"
    become=(sudo -n)
  fi
  say "installing with apt-get: $*"
  local apt=("${become[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=300 -o Dpkg::Use-Pty=0)
  log=$(mktemp)
  "${apt[@]}" update >"$log" 2>&1 || say "apt-get update did not fully succeed; going on with the lists there are"
  "${apt[@]}" install -y --no-install-recommends "$@" >>"$log" 2>&1 ||
    stop "apt-get could not install $*" "$(tail -n 20 "$log")"
  rm -f "$log"
}

system() {
  local missing=() python
  python=$(find_python)
  if ! venv_stands && ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
    missing+=("$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')")
  fi
  if [ "$goal" = test ]; then
    # Playwright's driver is linked against it.
    "$python" -c 'import ctypes; ctypes.CDLL("libatomic.so.1")' 2>/dev/null || missing+=(libatomic1)
    if ! browser_runs && [ "$(distribution "$python")" != ubuntu ]; then missing+=(chromium fonts-dejavu-core); fi
  fi
  if [ ${#missing[@]} -gt 0 ]; then apt_install "${missing[@]}"; fi
  venv_stands || make_venv "$python"
}

distribution() { "$1" -c 'import platform; print(platform.freedesktop_os_release()["ID"])' 2>/dev/null || echo unknown; }

# --- the environment --------------------------------------------------------------------------------------------------

make_venv() {
  say "making .venv with $("$1" -V)"
  rm -rf .venv
  "$1" -m venv .venv
}

# The key of a step: of the file it follows, the interpreter and the place.
key() { { cat "$1" && "$py" -V && pwd -P; } | sha256sum | cut -d' ' -f1; }
stands() { [ "$(cat ".venv/.stamp-$1" 2>/dev/null)" = "$2" ]; }
stamp() { printf '%s\n' "$2" >".venv/.stamp-$1"; }
pip() { "$py" -m pip --disable-pip-version-check --quiet "$@"; }

# packages NAME LOCK: by hash, and as wheels only: nothing is compiled, so no compiler is needed.
packages() {
  local now
  now=$(key "$2")
  if stands "$1" "$now"; then return; fi
  say "installing the packages of $2 (some minutes, the first time)"
  pip install --require-hashes --only-binary :all: -r "$2"
  stamp "$1" "$now"
}

# The project itself, editable, without a network.
project() {
  local now
  now=$(key pyproject.toml)
  if stands project "$now"; then return; fi
  pip install --no-index --no-deps --no-build-isolation --editable .
  stamp project "$now"
}

# Ubuntu has Chromium as a snap only.
own_browser() {
  if browser_runs || [ -e .venv/.stamp-browser ]; then return; fi
  say "asking Playwright for a browser of its own"
  "$py" -m playwright install --with-deps chromium ||
    stop "no browser could be installed. Install one with this command, or name one with WATTLANE_CHROMIUM=path:" \
      "  $py -m playwright install --with-deps chromium"
  stamp browser playwright
}

system
packages run requirements.lock
[ "$goal" = run ] || packages dev requirements-dev.lock
project
[ "$goal" != test ] || own_browser
