"""Programs: train a policy, evaluate it, draw its episodes. Nothing imports this package."""

import signal
import sys

if sys.argv[0] == "-m" and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # Ctrl-C while torch is imported ends a program without a traceback; see ``Program``.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
