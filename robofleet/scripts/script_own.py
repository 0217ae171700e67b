"""``robofleet run`` as a script starts it: the run ends when the script is gone, however that ended.

    python -P -m robofleet.scripts.script_own DESCRIPTOR run CONFIG ...

The script holds the other end of the pipe. When it closes, the run is interrupted as by Ctrl-C: a controlled stop.
"""

import os
import runpy
import signal
import sys
import threading


def _watch(descriptor: int) -> None:
    while os.read(descriptor, 1):
        pass
    os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    threading.Thread(target=_watch, args=(int(sys.argv.pop(1)),), daemon=True).start()
    runpy.run_module("robofleet", run_name="__main__", alter_sys=True)
