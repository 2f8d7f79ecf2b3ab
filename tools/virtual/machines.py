"""The two virtual machines that a guest can run in: a kernel as a process of this one, or an emulated computer."""

from __future__ import annotations

import os
import shutil
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from .kernels import Kernel

CHANNELS = ("stdout", "stderr", "control")
"""What comes out of the guest."""

_CAN = ("vcan", "can-raw", "can-bcm", "can-j1939", "can-gw")
_FAILING_DISKS = ("loop", "dm-mod", "ext4")
_QUIET = ("quiet", "loglevel=3", "panic=-1", "audit=0", "nowatchdog", "noautogroup")


@dataclass(frozen=True)
class Boot:
    """What a guest is booted with.

    Attributes
    ----------
    initrd : Path
        The initial RAM disk.
    scratch : Path
        A folder for what the machine needs while it runs.
    shares : tuple of Path
        Folders whose changes come out.
    memory_mb : int
    systemd : bool
        Whether a service manager runs.
    host_time : bool
        The host's clock and two processors, where there is a choice.
    """

    initrd: Path
    scratch: Path
    shares: tuple[Path, ...]
    memory_mb: int
    systemd: bool
    host_time: bool


@dataclass
class Started:
    """A command that boots the guest, and its channels as they are outside.

    Attributes
    ----------
    command : list of str
    pass_fds : tuple of int
        File descriptors that the command inherits, to be closed here once it runs.
    channels : dict of str to callable
        For each channel what waits for the guest and returns how the next bytes are read (empty: the end).
    environment : dict of str
        Beside the caller's.
    """

    command: list[str]
    pass_fds: tuple[int, ...]
    channels: dict[str, Callable[[], Callable[[], bytes]]]
    environment: dict[str, str]


class Machine(ABC):
    """One kind of virtual machine."""

    name: str
    kernel: Kernel
    tools: ClassVar[Mapping[str, str]]
    """Programs of the host that it needs -> their packages."""
    guest_environment: ClassVar[Mapping[str, str]]
    """Variables for what runs inside."""
    on_host_clock: bool
    """Whether time goes on inside while the host is busy with other work."""

    @abstractmethod
    def start(self, kernel: Path, boot: Boot) -> Started:
        """What boots it. kernel: folder in the cache."""


class UserMode(Machine):
    """User-mode Linux: the kernel is a process here, and its processes are too, so code runs at the processor's own pace and
    what waits costs nothing. One processor, the host's clock. Needs ptrace."""

    name = "user-mode"
    kernel = Kernel(
        name,
        "user-mode-linux",
        newest="",
        files="usr/bin/linux.uml",
        libraries="usr/lib/uml/modules/*",
        modules=("overlay", *_CAN, *_FAILING_DISKS),
    )
    tools: ClassVar[Mapping[str, str]] = {}
    guest_environment: ClassVar[Mapping[str, str]] = {}
    on_host_clock = True

    def start(self, kernel: Path, boot: Boot) -> Started:
        """See `Machine`."""
        pipes = {name: os.pipe() for name in CHANNELS}
        command = [str(kernel / "kernel"), f"mem={boot.memory_mb}M", f"initrd={boot.initrd}", f"uml_dir={boot.scratch}"]
        command += ["con=null", "con0=null,fd:1", "ssl=null", *_QUIET]
        command += [f"ssl{index}=null,fd:{pipes[name][1]}" for index, name in enumerate(CHANNELS)]
        readers = {name: self._reader(pipes[name][0]) for name in CHANNELS}
        return Started(command, tuple(pipe[1] for pipe in pipes.values()), readers, self._memory(boot))

    @staticmethod
    def _memory(boot: Boot) -> dict[str, str]:
        """Where the guest's memory is: in /dev/shm where that has room for it, as by itself."""
        shm = Path("/dev/shm")
        roomy = shm.is_dir() and shutil.disk_usage(shm).free > boot.memory_mb * 2**20
        return {"TMPDIR": str(shm if roomy else boot.scratch)}

    @staticmethod
    def _reader(descriptor: int) -> Callable[[], Callable[[], bytes]]:
        def wait() -> Callable[[], bytes]:
            return lambda: os.read(descriptor, 65536)

        return wait


class Qemu(Machine):
    """QEMU's software emulation. The guest's clock counts its instructions, a nanosecond each: it is a computer of 1,000 million
    instructions a second on every host, however loaded, and what only waits takes no time outside. Reading a file for the first
    time is the exception: there the guest's clock may run ahead by seconds. With a service manager, whose timeouts would not bear
    that, waiting takes as long outside as inside."""

    name = "qemu"
    kernel = Kernel(
        name,
        "linux-image-amd64",
        newest=r"linux-image-\d\S+-amd64",
        files="boot/vmlinuz-*",
        libraries="**/lib/modules/*",
        modules=("virtio_pci", "virtio_console", "9pnet_virtio", "9p", "overlay", *_CAN, *_FAILING_DISKS),
    )
    tools: ClassVar[Mapping[str, str]] = {"qemu-system-x86_64": "qemu-system-x86"}
    #: Under software emulation numpy's argsort for AVX2 (argsort_n_vec, masked gathers) ends with a segmentation fault on some
    #: small arrays.
    guest_environment: ClassVar[Mapping[str, str]] = {"NPY_DISABLE_CPU_FEATURES": "X86_V3"}
    on_host_clock = False

    #: One processor, since processors would share the counted instructions. The guest's own hardware clock goes with it.
    COUNTED_TIME = ("-accel", "tcg,thread=single", "-smp", "1", "-rtc", "clock=vm")
    #: While the processor is idle, waiting for the host's files say, counted time is set forward to the next timer.
    IDLE_SKIPPED = ("-icount", "shift=0,sleep=off")
    #: While the processor is idle, counted time goes on as the host's does.
    IDLE_LASTS = ("-icount", "shift=0,sleep=on")
    HOST_TIME = ("-accel", "tcg,thread=multi", "-smp", "2")

    def start(self, kernel: Path, boot: Boot) -> Started:
        """See `Machine`."""
        counted = (*self.COUNTED_TIME, *(self.IDLE_LASTS if boot.systemd else self.IDLE_SKIPPED))
        options = " ".join(("console=ttyS0", "random.trust_cpu=on", "mitigations=off", *_QUIET))
        command = ["qemu-system-x86_64", *(self.HOST_TIME if boot.host_time else counted), "-cpu", "max"]
        command += ["-m", str(boot.memory_mb), "-nodefaults", "-no-user-config", "-display", "none", "-no-reboot"]
        command += ["-serial", "stdio", "-append", options]
        command += ["-kernel", str(kernel / "kernel"), "-initrd", str(boot.initrd)]
        nine_p = "local,security_model=none,multidevs=remap"
        command += ["-virtfs", f"{nine_p},path=/,mount_tag=hostroot,readonly=on"]
        for index, folder in enumerate(boot.shares):
            command += ["-virtfs", f"{nine_p},path={str(folder.resolve()).replace(',', ',,')},mount_tag=share{index}"]
        command += ["-device", "virtio-serial-pci"]
        for name in CHANNELS:
            command += ["-chardev", f"socket,id={name},path={boot.scratch / name}"]
            command += ["-device", f"virtserialport,chardev={name},name={name}"]
        return Started(command, (), {name: self._reader(boot.scratch / name) for name in CHANNELS}, {})

    @staticmethod
    def _reader(path: Path) -> Callable[[], Callable[[], bytes]]:
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(str(path))
        listener.listen(1)
        listener.settimeout(30.0)

        def wait() -> Callable[[], bytes]:
            with listener:
                try:
                    connection, _ = listener.accept()
                except TimeoutError:
                    return lambda: b""
            return lambda: connection.recv(65536)

        return wait


MACHINES: tuple[Machine, ...] = (UserMode(), Qemu())
"""In order of preference."""
