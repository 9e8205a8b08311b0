"""Files that are either the old one or the new one, never half of one; which may be read and written."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from neuroflight.toolchain.errors import InUseError, NeuroflightError

LOCK = ".lock"  # in a folder
PROBE_BYTES = 64 << 10  # that a place must have room for


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a fresh path beside `path`; on success it replaces `path`, on any error it is removed.

    An OSError without a file's name, as that of a full disk, gets the name of `path`.
    """
    with _naming(path):
        _exists(path)  # raises for a name that no file can have
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = _fresh(path, path.parent)
        try:
            yield aside
            aside.chmod(0o666 & ~_umask())
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)


def check_writable(path: Path) -> None:
    """Raise OSError, naming `path`, if a file could not be written there: no room, not allowed, no such name.

    Nothing is left behind, nor are the folders made that lack.
    """
    with _naming(path):
        for folder in path.absolute().parents:
            if _exists(folder):
                break
        _exists(path)  # raises for a name that no file can have
        aside = _fresh(path, folder)
        try:
            with aside.open("wb") as file:
                file.write(bytes(PROBE_BYTES))
        finally:
            aside.unlink(missing_ok=True)


def file_size(path: Path) -> int:
    """Return the size of the regular file `path`. Raises OSError for anything else, such as a pipe."""
    try:
        facts = path.stat()
    except ValueError as error:  # a NUL in the name
        raise OSError(errno.EINVAL, "no file can have that name", repr(str(path))) from error
    if stat.S_ISDIR(facts.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(facts.st_mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device, not a file", str(path))
    return facts.st_size


def read_limited(path: Path, where: str, most: int, failure: type[NeuroflightError], mend: str = "") -> bytes:
    """Read a file of at most `most` bytes. Raises `failure`, naming `where`; mend: ends that on its size."""
    try:
        size = file_size(path)
        data = path.read_bytes() if size <= most else b""
    except OSError as error:
        raise failure(f"{where}: cannot be read: {error.strerror}") from error
    if size > most:
        raise failure(f"{where}: {size} bytes, expected at most {most}{mend}")
    return data


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of `folder`, which is made: one process at a time; it is released when that ends."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextmanager
def claimed(folder: Path, what: str) -> Iterator[None]:
    """Keep `folder`, which is made, for this process. Raises InUseError at once if another has it.

    what: claims it, for the message. The claim ends with the process, however that ends; a folder that is
    made for it and stays empty is removed again.
    """
    made = [parent for parent in (folder, *folder.absolute().parents) if not _exists(parent)]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with _holding(
            folder / LOCK, f"{folder} is in use by another {what}; wait for its end, or choose another folder"
        ):
            yield
    finally:
        with contextlib.suppress(OSError):  # it holds results
            for parent in made:
                parent.rmdir()


@contextmanager
def claimed_file(path: Path, what: str) -> Iterator[None]:
    """Keep the file `path`, which may be made and replaced meanwhile, for this process, as `claimed` does."""
    refusal = f"{path} is in use by another {what}; wait for its end, or name another"
    _exists(path)  # raises for a name that no file can have
    with _naming(path), _holding(path.with_name(f"{_prefix(path)}lock"), refusal):
        yield


@contextmanager
def _holding(lock: Path, refusal: str) -> Iterator[None]:
    """Hold the file `lock`, which is there only meanwhile. Raises InUseError where another process does."""
    handle = _hold(lock, refusal)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(handle)


def _hold(lock: Path, refusal: str) -> int:
    while True:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(handle)
            raise InUseError(refusal) from error
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), lock.stat()):
                return handle
        os.close(handle)  # whoever had it before removed it between the two calls


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` to `path` in one step; parents are made."""
    with replacing(path) as aside:
        aside.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write `text` (UTF-8, newlines as given) to `path` in one step; parents are made."""
    write_bytes(path, text.encode())


def write_text_if_changed(path: Path, text: str) -> bool:
    """Write `text` unless the file equals it already, which keeps its date. Returns True if it wrote."""
    return write_bytes_if_changed(path, text.encode())


def write_bytes_if_changed(path: Path, data: bytes) -> bool:
    """Write `data` as `write_text_if_changed` does."""
    if path.is_file() and path.read_bytes() == data:
        return False
    write_bytes(path, data)
    return True


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Give an OSError of the block that names no file, or the one beside `path`, the name of `path`."""
    try:
        yield
    except OSError as error:
        named = error.filename is not None and not Path(os.fsdecode(error.filename)).name.startswith(
            _prefix(path)
        )
        if error.errno is None or named:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def _prefix(path: Path) -> str:
    """Return the beginning of the names of files beside `path`, short enough for any file system."""
    return f".{path.name[:40]}."


def _fresh(path: Path, folder: Path) -> Path:
    """Create an empty file in `folder` with a new name like that of `path`."""
    handle, name = tempfile.mkstemp(prefix=_prefix(path), suffix=path.suffix[:10], dir=folder)
    os.close(handle)
    return Path(name)


def _exists(path: Path) -> bool:
    """Return True if the path exists. Raises OSError for an impossible name."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except ValueError as error:  # a NUL in the name
        raise OSError(errno.EINVAL, "no file can have that name", repr(str(path))) from error
    return True


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
