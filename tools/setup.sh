#!/bin/sh
# Make a virtual environment in which everything of breplake runs.
#
#     tools/setup.sh VENV [PYTHON]
#
# Finds a Python, installs the system libraries that gmsh and Open CASCADE load (Debian and its
# kin, through apt-get, with sudo where needed) and then the package, all extras and the tools of
# development at the versions of constraints.txt. Where it may not install, it names what is missing.
# `tools/setup.sh --libraries PYTHON` stops after the system libraries.
set -eu

say() { printf '%s\n' "$*"; }
fail() {
    printf 'setup: %s\n' "$@" >&2
    exit 1
}

# The library that is loaded, and the Debian package that brings it.
LIBRARIES='
libGL.so.1 libgl1
libGLU.so.1 libglu1-mesa
libX11.so.6 libx11-6
libXext.so.6 libxext6
libXfixes.so.3 libxfixes3
libXrender.so.1 libxrender1
libXcursor.so.1 libxcursor1
libXft.so.2 libxft2
libXinerama.so.1 libxinerama1
libfontconfig.so.1 libfontconfig1
libgomp.so.1 libgomp1
libexpat.so.1 libexpat1
'

# as_root COMMAND...: run as root, by sudo where needed; without a terminal sudo may not ask.
as_root() {
    if [ "$(id -u)" = 0 ]; then
        "$@"
    elif command -v sudo >/dev/null 2>&1; then
        if [ -t 0 ]; then sudo "$@"; else sudo -n "$@"; fi
    else
        return 1
    fi
}

# install_packages NAME...: install Debian packages, or say which ones a person has to install.
install_packages() {
    command -v apt-get >/dev/null 2>&1 ||
        fail "these Debian packages, or what brings the same on this system, are missing:" \
            "    $*" "there is no apt-get here, so please install them and run make again."
    say "setup: installing system packages: $*"
    if ! {
        as_root apt-get -qq update &&
            as_root env DEBIAN_FRONTEND=noninteractive \
                apt-get -qq install --yes --no-install-recommends "$@" >/dev/null
    }; then
        fail "the system packages could not be installed. As root, please run" \
            "    apt-get update && apt-get install --yes $*" "and then make again."
    fi
}

# usable PYTHON: whether that interpreter starts and has a version we support.
usable() {
    "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' >/dev/null 2>&1
}

# find_python [PYTHON]: print the interpreter to use, or nothing.
find_python() {
    [ -n "${1:-}" ] || set -- python3 python3.13 python3.12 python3.11 python3.14
    for candidate in "$@"; do
        if usable "$candidate"; then
            "$candidate" -c 'import sys; print(sys.executable)'
            return
        fi
    done
}

# require_python [PYTHON]: set $python to an interpreter that can make virtual environments.
require_python() {
    python=$(find_python "$@")
    if [ -z "$python" ] && [ -z "${1:-}" ] && command -v apt-get >/dev/null 2>&1; then
        install_packages python3 python3-venv
        python=$(find_python)
    fi
    [ -n "$python" ] ||
        fail "breplake needs Python 3.11, 3.12, 3.13 or 3.14, and found none (tried: ${1:-python3})." \
            "Install one, or name it: make setup PYTHON=/path/to/python3.12"
    if ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
        say "setup: $python cannot make virtual environments: its modules venv and ensurepip are missing"
        install_packages "$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')"
    fi
}

# missing_packages: print the packages of all libraries that cannot be loaded.
missing_packages() {
    printf '%s' "$LIBRARIES" | "$python" -c '
import ctypes, sys
for line in filter(str.strip, sys.stdin):
    library, package = line.split()
    try:
        ctypes.CDLL(library)
    except OSError:
        print(package)
'
}

require_libraries() {
    [ "$(uname -s)" = Linux ] || return 0 # elsewhere the wheels need nothing but the system's own
    missing=$(missing_packages)
    if [ -n "$missing" ]; then
        # shellcheck disable=SC2086 # one word is one package
        install_packages $missing
    fi
    missing=$(missing_packages)
    [ -z "$missing" ] || fail "still cannot load the libraries of:" $missing
}

# install VENV WHAT...: pip install into the environment; only errors are shown.
install() {
    environment=$1
    shift
    "$environment/bin/python" -m pip --disable-pip-version-check -qq \
        install --constraint constraints.txt --build-constraint constraints.txt "$@"
}

# make_environment VENV: create or renew it. One made for another folder (a moved or copied
# checkout) points there, so it is made anew.
make_environment() {
    if [ -f "$1/.ready" ] && [ "$(cat "$1/.ready")" != "$(pwd -P)" ]; then
        say "setup: $1 belongs to another folder; making it anew"
        rm -rf "$1"
    fi
    say "setup: $("$python" --version) in $1; the first time takes some minutes"
    "$python" -m venv "$1"
    "$1/bin/python" -m pip --disable-pip-version-check -qq \
        install --constraint constraints.txt --upgrade pip
    install "$1" --group dev --editable '.[all]'
    "$1/bin/python" -c 'import gmsh, OCP, torch, breplake' ||
        fail "the packages are installed, but importing them failed as shown above"
    pwd -P >"$1/.ready"
}

require_python "${2:-}"
require_libraries
[ "$1" = --libraries ] || make_environment "$1"
