"""Which devices compute, in this process and in worker processes, and how much memory they have free."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

import jax

from jaxurban.errors import InputError, one_of
from jaxurban.progress import LOG

DEVICES = ("auto", "cpu", "gpu")
PREALLOCATE = "XLA_PYTHON_CLIENT_PREALLOCATE"
VISIBLE = "CUDA_VISIBLE_DEVICES"
NO_GPU = (
    "there is no GPU that JAX can use: install jaxurban[cuda13] (or cuda12) and NVIDIA's driver, or leave --device out"
)
# Run by a process of its own: what JAX sees there, by the place of each device among those that are visible to CUDA.
ASK_JAX = """
import json, jax
print(json.dumps([
    {"platform": d.platform, "kind": d.device_kind, "place": d.local_hardware_id, "memory": d.memory_stats()}
    for d in jax.local_devices()
]))
"""


@dataclass(frozen=True)
class Gpu:
    """A GPU that a worker process has to itself.

    Attributes:
      name: what ``CUDA_VISIBLE_DEVICES`` calls it, an index or a UUID.
      kind: its model.
      limit_bytes: how much of its memory JAX takes at most; None where that is not known.
    """

    name: str
    kind: str = "GPU"
    limit_bytes: int | None = None

    @property
    def environment(self) -> dict[str, str]:
        """What a process must find in its environment before JAX starts, to compute on this GPU and no other."""
        return {
            VISIBLE: self.name,
            "JAX_CUDA_VISIBLE_DEVICES": "all",  # of the one that is left
            PREALLOCATE: os.environ.get(PREALLOCATE, "false"),
        }


def check_device(name: str) -> None:
    """Say in the log on which device JAX computes; nothing of this process is changed for it.

    Args:
      name: ``"cpu"``, ``"gpu"``, or ``"auto"`` for a GPU where JAX finds one, else the CPU.

    Raises:
      InputError: another name, or no GPU that JAX can use.
    """
    one_of("device", name, DEVICES)
    if name == "gpu" and jax.default_backend() == "cpu":
        raise InputError(NO_GPU)
    kind, memory = jax.local_devices()[0].device_kind, _described(gpu_free_bytes())
    LOG.info(f"device: {kind} ({jax.default_backend()}){memory}")


def bind_workers(name: str, num_workers: int) -> tuple[Gpu, ...]:
    """Return the GPU of each worker process; empty where the workers compute on a CPU.

    Where that is fewer processes than were asked for, the log says so.

    Args:
      name: of the device, as for `check_device`.
      num_workers: how many processes are asked for.

    Raises:
      InputError: another name, no GPU that JAX can use, or JAX does not start.
    """
    one_of("device", name, DEVICES)
    if name == "cpu":
        check_device(name)
        return ()
    gpus = find_gpus()
    if not gpus:
        if name == "gpu":
            raise InputError(NO_GPU)
        return ()
    bound = tuple(gpus[:num_workers])  # worker n has the n-th
    kinds = " or ".join(sorted({gpu.kind for gpu in bound}))
    limits = [gpu.limit_bytes for gpu in bound if gpu.limit_bytes is not None]
    memory = _described(min(limits) if len(limits) == len(bound) else None)
    LOG.info(f"device: {len(bound)} of {num_workers} worker processes, as each has a GPU of its own ({kinds}){memory}")
    return bound


def visible_names(places: Sequence[int], visible: str | None) -> list[str]:
    """Return what ``CUDA_VISIBLE_DEVICES`` of another process must say for it to see one of this one's devices.

    Args:
      places: of devices among those that are visible to CUDA here.
      visible: ``CUDA_VISIBLE_DEVICES`` here, indices or UUIDs; None where it is not set, so that all are visible.
    """
    if visible is None:
        return [str(place) for place in places]
    names = [name.strip() for name in visible.split(",")]
    return [names[place] for place in places]


def find_gpus() -> list[Gpu]:
    """Return the GPUs that JAX can use, which this process does not touch.

    A process of its own asks JAX, which alone knows the driver, the plugin and what the environment hides. Where no
    plugin is installed there is nothing to ask.

    Raises:
      InputError: JAX does not start there.
    """
    if not entry_points(group="jax_plugins") or os.environ.get("JAX_PLATFORMS") == "cpu":
        return []
    found = [device for device in ask_jax() if device["platform"] == "gpu"]
    names = visible_names([device["place"] for device in found], os.environ.get(VISIBLE))
    return [
        Gpu(name, device["kind"], (device["memory"] or {}).get("bytes_limit"))
        for name, device in zip(names, found, strict=True)
    ]


def ask_jax() -> list[dict[str, Any]]:
    """Return ``platform``, ``kind``, ``place`` and ``memory`` of the devices that JAX has in a process of its own.

    Raises:
      InputError: it does not start.
    """
    done = subprocess.run(
        [sys.executable, "-c", ASK_JAX],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, PREALLOCATE: "false"},
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
        raise InputError(f"JAX does not start on this machine's devices ({last}): mend that, or take --device cpu")
    return json.loads(done.stdout.splitlines()[-1])


def gpu_free_bytes() -> int | None:
    """Return how much memory JAX may still take on its GPU; None where it computes on a CPU."""
    if jax.default_backend() == "cpu":
        return None
    stats = jax.local_devices()[0].memory_stats() or {}
    return int(stats["bytes_limit"] - stats.get("bytes_in_use", 0)) if "bytes_limit" in stats else None


def _described(memory_bytes: int | None) -> str:
    taken = "as needed" if os.environ.get(PREALLOCATE, "true").lower() in ("false", "0") else "at once"
    return "" if memory_bytes is None else f", {memory_bytes / 2**30:,.0f} GiB of memory, taken {taken}"
