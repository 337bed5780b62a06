"""Research programs: reproduction, validation, benchmarks. Nothing imports this package."""

import gc
import signal
import sys

if sys.argv[0] == "-m":
    # Until ``Program`` begins: searching what imports make for garbage would take seconds, and
    # Ctrl-C ends the program without a traceback.
    gc.disable()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
