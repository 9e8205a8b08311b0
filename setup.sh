#!/bin/sh
# Brings .venv to what one extra of pyproject.toml needs. The Makefile calls it when the extra's stamp is missing or
# older than pyproject.toml, setup.py, constraints.txt or this file.
#
#   setup.sh firmware|gateway|sim|train|sweep|dev
#
# The stamp .venv/.NAME says that the extra NAME is installed whole. An extra brings what the smaller ones bring, so
# their stamps are written with its own; all of them are written at the very end.
#
# From the environment:
#   PYTHON  the interpreter of .venv, whether pybullet has a wheel for it or not
#   TORCH   cuda: the registry's torch with its CUDA packages, about 4 GB; otherwise the build for processors alone
set -eu
trap 'exit 130' INT TERM # a shell goes on when pip answers Ctrl-C by ending with an error
cd "$(dirname "$0")"

EXTRAS="firmware gateway sim train sweep dev" # from the smallest to the largest
PYTHONS="3.11 3.12 3.13 3.14"         # with wheels of everything that an image needs, in the order tried
FLYING="3.11 3.12 3.13"               # with wheels of pybullet, or of pybullet-arm64: pyproject.toml says which
TORCH_INDEX=https://download.pytorch.org/whl/cpu
VENV=.venv
FETCHED=.python # where uv puts an interpreter that this machine lacks
extra=$1
PYTHON=${PYTHON:-}
TORCH=${TORCH:-}

fail() {
	echo "$1" >&2
	exit 1
}

# The version X.Y of the interpreter $1 if it runs and has the module $2, otherwise nothing.
version() {
	"$1" -c "import sys, $2; print('%d.%d' % sys.version_info[:2])" 2>/dev/null || true
}

# The first interpreter of this machine that can make environments and has one of the versions given.
find_python() (
	IFS=:
	folders=$PATH:$(printf '%s:' "$PWD/$FETCHED"/*/bin)
	IFS=' '
	for wanted in $1; do
		IFS=:
		for folder in $folders; do
			for name in "python$wanted" python3; do
				if [ "$(version "$folder/$name" ensurepip)" = "$wanted" ]; then
					echo "$folder/$name"
					return
				fi
			done
		done
	done
)

# Whether this machine's kind has wheels of pybullet for some Python.
has_wheels() {
	case "$(uname -s) $(uname -m)" in *" x86_64" | "Darwin arm64") ;; *) false ;; esac
}

# Whether pybullet is in $VENV or comes to it without a compiler.
can_fly() {
	has pybullet || has pybullet-arm64 || { has_wheels && case " $FLYING " in *" $have "*) ;; *) false ;; esac; }
}

# Whether the distribution $1 is in $VENV, in a version that begins with $2.
has() {
	"$VENV/bin/python" -c "
import sys
from importlib.metadata import version
sys.exit(not version('$1').startswith('${2:-}'))" 2>/dev/null
}

pip() {
	"$VENV/bin/python" -m pip --quiet --disable-pip-version-check --no-input "$@"
}

# Brings the first interpreter of $FLYING into $FETCHED by uv, which is installed aside if need be.
fetch_python() (
	uv=$(command -v uv || true)
	if [ -z "$uv" ]; then
		aside=$(mktemp -d)
		trap 'rm -rf "$aside"' EXIT
		"$(find_python "$PYTHONS")" -m venv "$aside" || return 1
		"$aside/bin/python" -m pip install --constraint constraints.txt uv || return 1
		uv=$aside/bin/uv
	fi
	UV_PYTHON_INSTALL_DIR=$PWD/$FETCHED UV_PYTHON_INSTALL_BIN=0 "$uv" python install "${FLYING%% *}"
)

# Makes $VENV with the interpreter $1, in place of what is there.
make_environment() {
	rm -rf "$VENV"
	"$1" -m venv "$VENV"
}

case " $EXTRAS " in *" $extra "*) ;; *) fail "unknown extra '$extra', known are $EXTRAS" ;; esac
case $TORCH in "" | cuda) ;; *) fail "TORCH=$TORCH is unknown, known is cuda" ;; esac

have=$(version "$VENV/bin/python" pip)
if [ -n "$PYTHON" ]; then
	asked=$(version "$PYTHON" ensurepip)
	[ -n "$asked" ] || fail "PYTHON=$PYTHON does not run or lacks venv; give one of Python 3.11 or newer with it"
	[ "$asked" = "$have" ] || make_environment "$PYTHON"
elif [ "$extra" = firmware ] || [ "$extra" = gateway ]; then
	if [ -z "$have" ]; then
		base=$(find_python "$PYTHONS")
		[ -n "$base" ] || fail "no Python 3.11 to 3.14 with venv on the PATH; run: sudo apt-get install python3 python3-venv"
		make_environment "$base"
	fi
elif [ -z "$have" ] || ! can_fly; then
	lack="pybullet has wheels for Python 3.11 to 3.13 on x86_64 only"
	source="or let pip build it, about ten minutes on one core with a C++ compiler: make setup EXTRA=$extra PYTHON=python3"
	has_wheels || fail "$lack, this is $(uname -m); $source"
	base=$(find_python "$FLYING")
	if [ -z "$base" ]; then
		echo "$lack; fetching that Python with uv into $FETCHED"
		fetch_python >/dev/null 2>&1 || true
		base=$(find_python "$FLYING")
	fi
	[ -n "$base" ] || fail "$lack, found none and uv fetches none: install python3.11 with venv, $source"
	[ -z "$have" ] || echo "$VENV has Python $have, which pybullet has no wheel for; making it anew with $base"
	make_environment "$base"
fi

echo "setting up $VENV for $extra (once)"
case $extra in
train | sweep | dev)
	pinned=$(sed -n 's/^torch==//p' constraints.txt)
	if [ "$TORCH" = cuda ]; then
		pip install --constraint constraints.txt "torch===$pinned" # === leaves out the builds named +cpu
	elif ! has torch "$pinned"; then
		pip install --no-deps "torch==$pinned+cpu" 2>/dev/null ||
			pip install --no-deps --retries 1 --extra-index-url "$TORCH_INDEX" "torch==$pinned+cpu" 2>/dev/null ||
			echo "no torch without CUDA in pip's indexes or at $TORCH_INDEX; the registry's brings CUDA, about 4 GB"
	fi
	;;
esac
pip install --no-compile --constraint constraints.txt --editable ".[$extra]"

for name in $EXTRAS; do
	touch "$VENV/.$name"
	[ -z "$TORCH" ] || touch "$VENV/.$name-$TORCH"
	[ "$name" != "$extra" ] || break
done
