"""The `neuroflight` command: parses, makes one call into a room, prints, returns an exit code.

`cli/tree.py` says which module carries out which command.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import importlib
import importlib.util
import os
import shutil
import sys
import textwrap
from collections.abc import Sequence

from neuroflight.cli import tree
from neuroflight.cli.extras import EXTRAS, install_command
from neuroflight.cli.parsing import suggestion
from neuroflight.cli.tree import PROGRAM
from neuroflight.toolchain.errors import NeuroflightError

SUMMARY = (
    "From the digital twin of an aircraft to a flight firmware whose rate controller is a neural network."
)
# Matrices here are small: a second thread gains little, loses twenty times as much to a busy neighbour, and
# may round otherwise than the first alone, so that a seed would no longer say what a run gives.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


MENDS = {  # an operating system's error: what the user does about it
    errno.ENOSPC: "make room there, or choose another place",
    errno.EDQUOT: "make room there, or choose another place",
    errno.EFBIG: "raise the limit of file sizes (ulimit -f), or choose another place",
    errno.EROFS: "choose a place that can be written, or make this one writable",
    errno.EACCES: "choose a place that you may use, or change its permissions",
    errno.EPERM: "choose a place that you may use, or change its permissions",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOTDIR: "choose another place",
    errno.EISDIR: "name a file",
    errno.ENOENT: "check the name",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENOMEM: "close other programs, or ask for less at once",
    errno.EIO: "check the disk",
}
OF_WRITING = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
LINE_MAX = 2000  # characters of an error; what is longer quotes something of the user's at length
NAME_SHOWN = 200  # characters of a file's name


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Read a command line. Ends the process for --help, --version and, status 2, for unreadable lines.

    Where the line has old words, the result's `renamed` says which are the new ones, otherwise it is "".
    """
    line, renamed = tree.rewritten(argv)
    words, rest = tree.find(line)
    if words:
        return tree.leaf_parser(words, rest).parse_args(rest, argparse.Namespace(renamed=renamed))
    group = next((" ".join(line[:n]) for n in (2, 1) if " ".join(line[:n]) in tree.NOUNS), "")
    word = next(iter(line[len(group.split()) :]), "")
    if word in ("-h", "--help"):
        print(_help(group))
        sys.exit(0)
    if word == "--version" and not group:
        print(f"{PROGRAM} {version()}")
        sys.exit(0)
    if not word:
        print(_help(group), file=sys.stderr)
        sys.exit(2)
    name = f"{PROGRAM} {group}".strip()
    if gone := tree.GONE.get(f"{group} {word}".strip()):
        print(f"{name}: {word!r} is gone: {gone}", file=sys.stderr)
        sys.exit(2)
    print(f"{name}: no command {word!r}{_meant(group, word)}; {name} --help lists them", file=sys.stderr)
    sys.exit(2)


def _meant(group: str, word: str) -> str:
    """Return "; did you mean ...?" of a command that is like the word, at its place or below another noun."""
    near = suggestion(word, [*tree.below(group), *(() if group else tree.ALIASES)])
    elsewhere = [words for words in tree.COMMANDS if words.split()[-1] == word]
    return f"; did you mean {' or '.join(elsewhere)}?" if elsewhere else near


def _help(group: str) -> str:
    """Return the help of a noun; of all, where `group` is ""."""
    name, width = f"{PROGRAM} {group}".strip(), shutil.get_terminal_size().columns - 2
    below = tree.below(group)
    column = max(map(len, below)) + 4
    lines = [f"usage: {name} COMMAND ...", "", *textwrap.wrap(tree.NOUNS.get(group, SUMMARY), width), ""]
    for word, text in below.items():
        first = f"  {word}".ljust(column)
        lines += textwrap.wrap(text, width, initial_indent=first, subsequent_indent=" " * column)
    return "\n".join([*lines, "", f"{name} COMMAND --help tells more of one"])


def version() -> str:
    """Return the version that is installed."""
    from importlib.metadata import PackageNotFoundError
    from importlib.metadata import version as installed

    try:
        return installed(PROGRAM)
    except PackageNotFoundError:
        return "not installed"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command. Returns 0, or 1 after one line on stderr about a mistake of the user's."""
    for name in THREADS:  # numpy and torch read them when they are first imported, in a command's run
        os.environ.setdefault(name, "1")
    _open_standard_streams()
    try:
        args = parse(sys.argv[1:] if argv is None else argv)
        _check_stdout()
        code = run_command(args)
        sys.stdout.flush()
        if args.renamed and code == 0:  # not beside an error, which is one line
            print(f"{PROGRAM}: {args.renamed}", file=sys.stderr)
        return code
    except NeuroflightError as error:
        return _fail(f"{error}")
    except KeyboardInterrupt:
        _fail("interrupted; what was finished is kept")
        return 130
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe
        _silence_stdout()
        return 1
    except OSError as error:
        return _fail(os_error_line(error))


def os_error_line(error: OSError) -> str:
    """Return the cause of an error of the operating system, its file, and what the user does about it."""
    what = error.strerror or str(error) or type(error).__name__
    where = _where(error)
    mend = MENDS.get(error.errno or 0)
    return f"{where}{': ' if where else ''}{what}{'; ' if mend else ''}{mend or ''}"


def _where(error: OSError) -> str:
    """Return the file of an error. One without a name is of other outputs: written files are named."""
    if error.filename is not None:
        name = os.fsdecode(error.filename) if isinstance(error.filename, bytes) else str(error.filename)
        return name if len(name) <= NAME_SHOWN else f"{name[:NAME_SHOWN]}... ({len(name)} characters)"
    return "stdout or a temporary file" if error.errno in OF_WRITING else ""


def _fail(line: str) -> int:
    """Print one line on stderr, after flushing stdout if possible. Returns 1."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        _silence_stdout()
    if len(line) > LINE_MAX:
        line = f"{line[: LINE_MAX // 2]} ... {line[-LINE_MAX // 2 :]}"
    with contextlib.suppress(OSError):
        print(f"neuroflight: {line}", file=sys.stderr)
    return 1


def _silence_stdout() -> None:
    """Discard the rest of stdout: else the interpreter tries to write it again as it ends, and complains."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _open_standard_streams() -> None:
    """Open closed standard streams as /dev/null: else the next file that is opened would be one of them."""
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(handle, True)
    os.close(handle)
    if sys.stderr is None:
        sys.stderr = open(2, "w", closefd=False)  # noqa: SIM115 - open until the end


def _check_stdout() -> None:
    """Raise NeuroflightError if nobody could read the result of the work."""
    if sys.stdout is None:
        sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115 - open until the end
        raise NeuroflightError("stdout is closed; give it a place, such as >/dev/null")


def run_command(args: argparse.Namespace) -> int:
    """Return the command's exit code. Raises NeuroflightError where an extra is not installed."""
    try:
        return int(args.request.parsed(args).run())
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        brings = [extra for extra, packages in EXTRAS.items() if package in packages]
        if not brings or importlib.util.find_spec(package) is not None:
            raise
        brings += filter(None, [tree.COMMANDS[args.command].extra])
        extra = max(brings, key=list(EXTRAS).index)  # the larger brings the smaller
        raise NeuroflightError(
            f"{args.command} needs {package}, which is not installed; run: {install_command(extra)}"
        ) from error


if __name__ == "__main__":
    sys.exit(main())
