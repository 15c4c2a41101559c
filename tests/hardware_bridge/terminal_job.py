"""A job in a terminal, as a shell would start it: this module leads the session, its child reads the keyboard.

The child prints what happens, one line each; ``q`` ends it.
"""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import termios
import time

from hardware_bridge.keyboard import Keyboard


def lead() -> int:
    """Take standard input as the session's terminal and run a child in the foreground of it."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    command = [sys.executable, "-m", "tests.hardware_bridge.terminal_job", "read"]
    with subprocess.Popen(command, process_group=0) as child:
        os.tcsetpgrp(0, child.pid)
        return child.wait()


def read() -> None:
    """Print keys until ``q``."""
    while os.tcgetpgrp(0) != os.getpgrp():
        time.sleep(0.01)
    with Keyboard(before_suspend=lambda: os.write(1, b"suspending\n")) as keyboard:
        print(os.getpid(), flush=True)
        while True:
            for key in keyboard.read(timeout_s=1.0):
                print(key, flush=True)
                if key in ("q", "hangup"):
                    return


if __name__ == "__main__":
    sys.exit(read() if sys.argv[1:] else lead())
