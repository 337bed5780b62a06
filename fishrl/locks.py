"""Locks of files, which end with the process that holds them."""

import logging
from typing import IO, Any

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

logger = logging.getLogger(__name__)


def take_lock(file: IO[Any], *, waits: bool = False, is_passed_on: bool = False) -> bool:
    """Lock an open file until it is closed or this process ends; False if another one holds it.

    A file that is open for reading gets a lock that others may share. Where there are no locks, on
    a file system or on Windows, it counts as locked, and that is logged.

    Args:
        file: the file.
        waits: wait until it is free.
        is_passed_on: child processes that get the open file hold the lock too, and threads of this
            process exclude each other.
    """
    try:
        if fcntl is None:
            raise OSError("this system has no fcntl")
        how = fcntl.LOCK_EX if file.writable() else fcntl.LOCK_SH
        take = fcntl.flock if is_passed_on else fcntl.lockf
        try:
            take(file, how | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            if not waits:
                return False
            logger.info("waiting for another process, which holds %s", file.name)
            take(file, how)
    except OSError as error:
        logger.info("%s cannot be locked (%s): start nothing twice", file.name, error)
    return True
