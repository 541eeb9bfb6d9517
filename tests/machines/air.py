"""Machines that are network namespaces, and the air between them: packets in user space, through TUN devices.

Each packet may come late, out of a narrow pipe, or not at all, and what TCP makes of that is the kernel's own
doing. It needs root, /dev/net/tun, and unshare, nsenter and ip; no kernel with sch_netem.
"""

import ctypes
import fcntl
import heapq
import os
import random
import select
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
CLONE_NEWNET = 0x40000000
NETWORK = "10.99.0"
MTU = 1400
QUEUE_S = 2.0
"""What would wait longer for a narrow link is lost, as in any modem."""


class Space:
    """A network namespace: it lasts as long as this process or what runs in it."""

    def __init__(self) -> None:
        self._holder = subprocess.Popen(
            ["unshare", "--net", "--fork", "--kill-child", "sh", "-c", "echo; exec sleep infinity"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        assert self._holder.stdout
        assert self._holder.stderr
        if not self._holder.stdout.readline():
            raise RuntimeError(f"no network namespaces here: {self._holder.stderr.read().decode()}")
        child = Path(f"/proc/{self._holder.pid}/task/{self._holder.pid}/children").read_text().strip()
        self._path = f"/proc/{child}/ns/net"
        self.run("ip", "link", "set", "lo", "up")

    def command(self, *words: object) -> list[str]:
        """`words` as a command that runs in here."""
        return ["nsenter", f"--net={self._path}", "--", *map(str, words)]

    def run(self, *words: object) -> str:
        """Output of a command in here. Fails where it does."""
        done = subprocess.run(self.command(*words), capture_output=True, text=True, check=False, timeout=600)
        if done.returncode:
            raise RuntimeError(f"{words}: {done.stderr}")
        return done.stdout

    def inside(self, call: Callable[[], T]) -> T:
        """What `call` gives in here: sockets and devices that it opens stay in here. Raises what it does."""

        def enter() -> T:
            with Path(self._path).open() as space:
                if ctypes.CDLL(None, use_errno=True).setns(space.fileno(), CLONE_NEWNET):
                    raise OSError(ctypes.get_errno(), "setns")
            return call()

        # a thread of its own, which ends in there: this one stays where it is
        with ThreadPoolExecutor(1) as pool:
            return pool.submit(enter).result()

    def close(self) -> None:
        self._holder.kill()
        self._holder.communicate()


@dataclass
class Link:
    """How it is between a machine and the air, each way."""

    loss: float = 0.0
    """Share of the packets that do not arrive."""
    delay_s: float = 0.0
    jitter_s: float = 0.0
    """At most so much more; no packet overtakes another."""
    bytes_per_s: float = float("inf")
    cut: bool = False
    passed_bytes: int = 0


class Air:
    """A network that all machines are on, with a link for each: `links[name]` may be changed at any time."""

    def __init__(self, seed: int = 1) -> None:
        self.links: dict[str, Link] = {}
        self._random = random.Random(seed)
        self._devices: dict[str, int] = {}
        self._hosts: dict[bytes, str] = {}
        self._free: dict[tuple[str, bool], float] = {}
        self._due: list[tuple[float, int, str, bytes]] = []
        self._count = count()
        self._wake, self._waker = os.pipe()
        self._over = False
        self._thread = threading.Thread(target=self._run, name="air", daemon=True)

    def join(self, name: str, space: Space) -> str:
        """Puts a machine on the air; gives its address."""
        address = f"{NETWORK}.{len(self.links) + 1}"
        self._devices[name] = space.inside(_open_tun)
        self._hosts[socket.inet_aton(address)] = name
        self.links[name] = Link()
        space.run("ip", "address", "add", f"{address}/24", "dev", "air")
        space.run("ip", "link", "set", "air", "mtu", MTU, "up")
        return address

    def start(self) -> None:
        """From now on packets pass. All machines must have joined."""
        self._thread.start()

    def close(self) -> None:
        self._over = True
        os.write(self._waker, b"x")
        if self._thread.is_alive():
            self._thread.join()
        for device in (*self._devices.values(), self._wake, self._waker):
            os.close(device)

    def _run(self) -> None:
        names = {device: name for name, device in self._devices.items()}
        poll = select.poll()
        for device in (*names, self._wake):
            poll.register(device, select.POLLIN)
        while not self._over:
            rest = self._due[0][0] - time.monotonic() if self._due else 1.0
            for device, _ in poll.poll(max(0.0, rest) * 1e3):
                if device in names:
                    self._take(names[device], os.read(device, 65536))
            while self._due and self._due[0][0] <= time.monotonic():
                _, _, name, packet = heapq.heappop(self._due)
                with suppress(OSError):  # its device is down
                    os.write(self._devices[name], packet)

    def _take(self, source: str, packet: bytes) -> None:
        target = self._hosts.get(packet[16:20]) if packet[0] >> 4 == 4 else None
        if target is None:
            return
        due = time.monotonic()
        for name, up in ((source, True), (target, False)):
            link, way = self.links[name], (name, up)
            free = max(self._free.get(way, 0.0), due + link.delay_s)
            due = free + len(packet) / link.bytes_per_s + link.jitter_s * self._random.random()
            if link.cut or self._random.random() < link.loss or free - time.monotonic() > QUEUE_S:
                return
            link.passed_bytes += len(packet)
            self._free[way] = due
        heapq.heappush(self._due, (due, next(self._count), target, packet))


def _open_tun() -> int:
    device = os.open("/dev/net/tun", os.O_RDWR)
    fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH22x", b"air", IFF_TUN | IFF_NO_PI))
    return device


@contextmanager
def door(space: Space, port: int) -> Iterator[int]:
    """A port of this machine that leads to `port` of 127.0.0.1 in `space`."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        opened: list[socket.socket] = []
        thread = threading.Thread(target=_accept, args=(listener, space, port, opened), daemon=True)
        thread.start()
        yield int(listener.getsockname()[1])
        for one in (listener, *opened):
            with suppress(OSError):  # closed by its other end
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        thread.join()


def _accept(listener: socket.socket, space: Space, port: int, opened: list[socket.socket]) -> None:
    with suppress(OSError):  # closed
        while True:
            near, _ = listener.accept()
            try:
                far = space.inside(lambda: socket.create_connection(("127.0.0.1", port)))
            except OSError:  # nobody listens
                near.close()
                continue
            opened += [near, far]
            for ends in ((near, far), (far, near)):
                ends[0].setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=_pass, args=ends, daemon=True).start()


def _pass(source: socket.socket, sink: socket.socket) -> None:
    with suppress(OSError):
        while chunk := source.recv(65536):
            sink.sendall(chunk)
    for end in (source, sink):
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
