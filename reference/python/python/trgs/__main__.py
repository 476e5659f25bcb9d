"""The program `trgs`, as `python -m trgs` and as the command of the package."""

import os
import signal
import sys

from . import _core
from .conformance import _FOLDER


def main() -> None:
    """Runs the program with the arguments of the process, and ends it with its exit code."""
    if _FOLDER.is_dir():
        os.environ.setdefault("TRGS_VECTORS", str(_FOLDER))
    # The program handles Ctrl-C itself. Where the parent process ignores it, it stays ignored.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(_core.command_line(["trgs", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
