"""Locks of files, which end with the process that holds them."""

import logging
from typing import IO, Any

from fishrl.forks import leave_to_parent

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

logger = logging.getLogger(__name__)


def take_lock(file: IO[Any], *, waits: bool = False) -> bool:
    """Lock an open file until it is closed or this process ends; False if it is locked already.

    The lock belongs to the open file: a process excludes itself, too, and children that are given
    the file hold the lock with it. A file that is open for reading gets a lock that others may
    share. Where there are no locks, on a file system or on Windows, it counts as locked, and that
    is logged.

    Args:
        file: the file.
        waits: wait until it is free.
    """
    try:
        if fcntl is None:
            raise OSError("this system has no fcntl")
        how = fcntl.LOCK_EX if file.writable() else fcntl.LOCK_SH
        try:
            fcntl.flock(file, how | fcntl.LOCK_NB)
        except BlockingIOError:
            if not waits:
                return False
            logger.info("waiting for another process, which holds %s", file.name)
            fcntl.flock(file, how)
    except OSError as error:
        logger.info("%s cannot be locked (%s): start nothing twice", file.name, error)
    leave_to_parent(file)
    return True
