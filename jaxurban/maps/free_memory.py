"""How much memory this process may still take: of the machine, of its control groups, and of a GPU."""

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

import psutil

from jaxurban.errors import InputError

LEAST_BYTES = 10**6  # that a number without a unit may mean: fewer hold no maps
# Under Linux, by the file system of control groups: the file of a group's limit, and what it cannot give back.
GROUP_FILES = {
    "cgroup": ("memory.limit_in_bytes", ("total_rss", "total_shmem")),
    "cgroup2": ("memory.max", ("anon", "shmem")),
}


def free_bytes(root: Path = Path("/")) -> int:
    """Return how much memory this process may still take: what the machine has, or its control groups if that is less.

    Args:
      root: of the file system, where ``proc/self`` names the groups.
    """
    return min([psutil.virtual_memory().available, *_left_in_groups(root)])


def _left_in_groups(root: Path) -> list[int]:
    """Return the bytes that are left under each limit of the control groups that hold this process (cgroups(7)).

    A group's limit holds for all groups in it, so every level counts, up to where the groups are mounted. In a
    container the group may not exist there by its name: then the levels above it count.

    Args:
      root: of the file system.
    """
    left = []
    for level, file_system in _group_levels(root):
        limit_file, used_names = GROUP_FILES[file_system]
        # A level has no limit where its folder or its files are missing, or where the limit reads "max".
        with suppress(OSError, ValueError):
            limit = int((level / limit_file).read_text())
            lines = (level / "memory.stat").read_text().splitlines()
            stat = dict(line.split() for line in lines)
            left.append(limit - sum(int(stat.get(name, 0)) for name in used_names))
    return left


def _group_levels(root: Path) -> Iterator[tuple[Path, str]]:
    """Yield the folders of this process's control groups and of the groups above them.

    Each comes with the type of its file system: ``"cgroup"`` of version 1, ``"cgroup2"`` of version 2. None come on
    systems other than Linux.
    """
    try:
        listed = (root / "proc/self/cgroup").read_text(errors="surrogateescape")
        mounts = (root / "proc/self/mountinfo").read_text(errors="surrogateescape").splitlines()
    except OSError:  # another system
        return

    # The name of the group that holds this process, by file system, from lines "number:resources:name".
    names = {}
    for line in listed.splitlines():
        if line.count(":") >= 2:
            _, resources, name = line.split(":", 2)
            if not resources:
                names["cgroup2"] = name
            elif "memory" in resources.split(","):
                names["cgroup"] = name

    # Where groups are mounted, from lines "... top place ... - file_system ...": the group `top` is seen at `place`.
    for line in mounts:
        before, _, after = line.partition(" - ")
        file_system = after.split(" ")[0]
        fields = before.split()
        if file_system not in names or len(fields) < 5:
            continue
        top, place = map(_unescaped, fields[3:5])
        group = PurePosixPath(names[file_system])
        mounted = root / place.lstrip("/")
        within = PurePosixPath()
        if group.is_relative_to(top) and ".." not in group.parts:
            within = group.relative_to(top)
        for level in (within, *within.parents):
            yield mounted / level, file_system


def _unescaped(field: str) -> str:
    """Return a field of ``mountinfo`` without its octal escapes."""
    return re.sub(r"\\([0-7]{3})", lambda code: chr(int(code[1], 8)), field)


def gpu_free_bytes() -> int | None:
    """Return how much memory JAX may still take on its GPU; None where it computes on a CPU or does not say."""
    import jax

    stats = jax.local_devices()[0].memory_stats() or {}
    if "bytes_limit" not in stats:
        return None
    return int(stats["bytes_limit"] - stats.get("bytes_in_use", 0))


def parse_bytes(text: str, name: str = "memory") -> int:
    """Return the bytes in a size such as ``"4GiB"`` or ``"512 MB"``: of KiB, MiB ... by 1,024, of kB, MB ... by 1,000.

    Args:
      text: a number above 0 and a unit; without one bytes, of which there are a million at least.
      name: of the setting, for the message.

    Raises:
      InputError: the text is not such a size.
    """
    from dask.utils import parse_bytes as bytes_of  # imported here: it takes 0.1 s

    num_bytes = 0
    with suppress(ValueError, OverflowError):
        num_bytes = bytes_of(text)
    has_no_unit = text.strip().isdigit() and num_bytes < LEAST_BYTES
    if num_bytes <= 0 or not text[:1].isdigit() or has_no_unit:
        raise InputError(f"{name} must be a size such as 4GiB or 800MiB, got {text!r}")
    return num_bytes
