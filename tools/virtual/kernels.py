"""The kernels of the virtual machines, from Debian's packages into a cache."""

from __future__ import annotations

import hashlib
import lzma
import os
import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from . import packages
from .packages import VmError


@dataclass(frozen=True)
class Kernel:
    """A kernel as Debian has it.

    Attributes
    ----------
    name : str
        Of its folder in the cache.
    package : str
        The package that holds it, or the one that depends on the package of the newest version.
    newest : str
        Regular expression of that package's name; empty where `package` holds the kernel itself.
    files : str
        Glob of the kernel in the unpacked package.
    libraries : str
        Glob of the folder of modules of one version there.
    modules : tuple of str
        What the guest loads, in this order, each after what it depends on.
    """

    name: str
    package: str
    newest: str
    files: str
    libraries: str
    modules: tuple[str, ...]

    def folder(self) -> Path | None:
        """The newest complete one in the cache: kernel, busybox, modules/ and modules/order; None where there is none."""
        complete = sorted(_cache().glob(f"{self.name}-*.{self._key}"), key=lambda folder: folder.stat().st_mtime)
        return complete[-1] if complete else None

    def fetch(self) -> Path:
        """Download Debian's current one and keep what the guest boots with."""
        _cache().mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=_cache(), prefix="fetch-") as scratch_name:
            scratch = Path(scratch_name)
            root = packages.download(scratch, self._package(), "busybox-static")
            kept = scratch / "kept"
            (kept / "modules").mkdir(parents=True)
            shutil.copy(next(root.glob(self.files)), kept / "kernel")
            shutil.copy(next(root.glob("**/bin/busybox")), kept / "busybox")
            libraries = next(root.glob(self.libraries))
            order = [_copy_module(path, kept / "modules") for path in self._module_files(scratch, libraries)]
            (kept / "modules/order").write_text("".join(f"{name}\n" for name in order))
            target = _cache() / f"{self.name}-{libraries.name}.{self._key}"
            if not target.exists():
                kept.rename(target)
        return target

    def forget(self) -> None:
        """Remove it from the cache."""
        while (folder := self.folder()) is not None:
            shutil.rmtree(folder)

    @property
    def _key(self) -> str:
        return hashlib.sha256(" ".join(self.modules).encode()).hexdigest()[:8]

    def _package(self) -> str:
        if not self.newest:
            return self.package
        found = packages.dependency(self.package, self.newest)
        if found is None:
            packages.update()
            found = packages.dependency(self.package, self.newest)
        if found is None:
            raise VmError(f"no {self.package} among apt's packages; expected Debian's main archive in its sources")
        return found

    def _module_files(self, scratch: Path, libraries: Path) -> list[Path]:
        """Files of the modules and what they need, in loading order."""
        base, version = scratch / "modules", libraries.name
        (base / "lib/modules").mkdir(parents=True)
        (base / "lib/modules" / version).symlink_to(libraries)
        packages.kmod("depmod", "-b", str(base), version)
        files: list[Path] = []
        for module in self.modules:
            for line in packages.kmod("modprobe", "-d", str(base), "-S", version, "--show-depends", module).splitlines():
                kind, _, name = line.strip().partition(" ")
                # The generic checksum does; this one needs instructions that an emulated processor may not have.
                if kind == "insmod" and Path(name) not in files and "crc32c-intel" not in name:
                    files.append(Path(name.strip()))
        return files


def _cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "yieldmon-vm"


def _copy_module(path: Path, folder: Path) -> str:
    """Copy, unpacked: the guest's insmod takes plain modules only."""
    content = path.read_bytes()
    name = re.sub(r"\.xz$", "", path.name)
    (folder / name).write_bytes(lzma.decompress(content) if name != path.name else content)
    return name
