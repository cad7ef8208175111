"""Starts daemons in processes of their own, quickly, so that a test can kill them: one line in, one process out.

A line on stdin names the configuration and the file for the log; the answer is the process id.  Everything that is
imported is imported once, here; the daemon itself is the real one.
"""

import asyncio
import os
import signal
import sys
import traceback
from pathlib import Path

import slabcell.service.api.server  # noqa: F401 - imported here, so that no child has to
from slabcell.logs import log_to_stream
from slabcell.service.daemon import run_daemon


def live(config: str, log: str) -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    stream = Path(log).open("a", encoding="utf-8")  # noqa: SIM115 - it is open as long as the process lives
    os.dup2(stream.fileno(), 1)
    os.dup2(stream.fileno(), 2)
    log_to_stream(stream)
    asyncio.run(run_daemon(Path(config)))


def main() -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    for line in sys.stdin:
        config, log = line.rstrip("\n").split("\t")
        child = os.fork()
        if child == 0:
            sys.stdin.close()
            try:
                live(config, log)
            except BaseException:  # noqa: BLE001 - it is told, and the process ends
                traceback.print_exc()
                os._exit(1)
            os._exit(0)
        print(child, flush=True)


if __name__ == "__main__":
    main()
