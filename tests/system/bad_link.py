"""A bad radio between two TCP ends, in user space: slow, or silent as behind a closing lift door.

What TCP makes of lost packets is delay, and of a partition silence: both are made here, on any machine and
without root or a kernel with sch_netem. Single packets cannot be lost so.
"""

import socket
import threading
import time
from contextlib import suppress

CHUNK = 16_384


class BadLink:
    """Passes all from `port` to `target`; 16 kB take `delay_s`, and nothing passes while it is cut."""

    def __init__(self, target: int) -> None:
        self._target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self.delay_s = 0.0
        self.down_bytes = 0
        """Bytes that came from `target`."""
        self._whole = threading.Event()
        self._whole.set()
        self._open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Nothing passes any more, and nobody is notified."""
        self._whole.clear()

    def mend(self) -> None:
        """What waited passes, and what comes."""
        self._whole.set()

    def close(self) -> None:
        for one in (self._listener, *self._open):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        self._whole.set()

    def _accept(self) -> None:
        with suppress(OSError):  # closed
            while True:
                near, _ = self._listener.accept()
                self._whole.wait()
                far = socket.create_connection(("127.0.0.1", self._target))
                self._open += [near, far]
                for ends in ((near, far), (far, near)):
                    for end in ends:
                        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    threading.Thread(target=self._pass, args=(*ends, ends[0] is far), daemon=True).start()

    def _pass(self, source: socket.socket, sink: socket.socket, down: bool) -> None:
        with suppress(OSError):
            while chunk := source.recv(CHUNK):
                time.sleep(self.delay_s)
                self._whole.wait()
                sink.sendall(chunk)
                if down:
                    self.down_bytes += len(chunk)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
