"""Checks that only this user and root can have changed a folder or file."""

import contextlib
import errno
import os
import pwd
import stat
from pathlib import Path

MAX_LINKS = 40  # as the kernel
GROUP_OR_OTHERS = stat.S_IWGRP | stat.S_IWOTH


class Untrusted(Exception):
    """Another user may have changed it; the text gives the reason, and a simple remedy if any."""


def check_folder(folder: Path, make: int | None = None) -> Path:
    """Return the path of a folder, unless another user can change its content.

    Every folder from / down must belong to this user or to root, and neither its group nor others
    may write to it. Above the folder itself a sticky folder such as /tmp is accepted: users cannot
    replace each other's files there. A link on the way is followed if it belongs to this user or to
    root, since no other user can redirect it; the folder itself must not be a link. `..` means the
    parent of the folder reached so far, as for the kernel.

    The walk goes from above: once a folder has been checked, no other user can replace it, then or
    later. The result therefore holds for the returned path, which has neither links nor `..`; the
    given path may lead elsewhere by then.

    Args:
        folder: the folder; a relative path starts at the working folder.
        make: mode of missing folders, which are created; None: they are not.

    Raises:
        Untrusted: see above.
        OSError: it is missing, not a folder, or cannot be created.
    """
    at, links = "/", 0
    left = _split_path(os.path.join(os.getcwd(), folder))  # the next part is the last of these
    while True:
        try:
            status = os.lstat(at)
        except FileNotFoundError:
            if make is None:
                raise
            with contextlib.suppress(FileExistsError):
                os.mkdir(at, make)
            status = os.lstat(at)
        _check_owner(at, status)
        if stat.S_ISLNK(status.st_mode):
            links += 1
            if not left:
                raise Untrusted(f"{at} is a link (name the folder it leads to)")
            if links > MAX_LINKS:
                raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), at)
            target = os.readlink(at)
            left += _split_path(target)
            at = "/" if target.startswith("/") else os.path.dirname(at)
            continue
        if not stat.S_ISDIR(status.st_mode):
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), at)
        if not (left and status.st_mode & stat.S_ISVTX):
            _check_mode(at, status)
        if not left:
            return Path(at)
        part = left.pop()
        # `at` has no links: its parent is what its path names.
        at = os.path.dirname(at) if part == ".." else os.path.join(at, part)


def _split_path(path: str) -> list[str]:
    return [part for part in reversed(path.split("/")) if part not in ("", ".")]


def read_file(file: Path, largest: int, anybodys: bool = False) -> bytes:
    """Return the bytes of a file that only this user and root can have written; mark it as used.

    Its folder must have passed `check_folder`.

    Args:
        file: the file.
        largest: largest number of bytes to read.
        anybodys: skip the check of its owner and mode.

    Raises:
        Untrusted: it is a link, not a file, too large, or another user can write to it.
        OSError: it is missing, or cannot be read.
    """
    try:
        # Without blocking: opening a pipe would wait for a writer indefinitely.
        opened = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO):
            raise Untrusted("it is a link or a socket") from None
        raise
    try:
        status = os.fstat(opened)
        if not stat.S_ISREG(status.st_mode):
            raise Untrusted("it is no file")
        if not anybodys:
            _check_owner(str(file), status)
            _check_mode(str(file), status)
        if status.st_size > largest:
            raise Untrusted(f"it holds {status.st_size} bytes")
        with contextlib.suppress(OSError):  # owned by root, or on a read-only file system
            os.utime(opened)
        with open(opened, "rb", closefd=False) as handle:
            return handle.read(largest)
    finally:
        os.close(opened)


def _check_owner(at: str, status: os.stat_result) -> None:
    if status.st_uid not in (0, os.geteuid()):
        raise Untrusted(f"{at} belongs to {_name_user(status.st_uid)}")


def _check_mode(at: str, status: os.stat_result) -> None:
    if status.st_mode & GROUP_OR_OTHERS:
        who = "others" if status.st_mode & stat.S_IWOTH else "its group"
        raise Untrusted(f"{at} can be written by {who} (chmod go-w {at})")


def _name_user(number: int) -> str:
    try:
        return f"user {pwd.getpwuid(number).pw_name}"
    except KeyError:
        return f"user {number}"
