"""Which device JAX computes on, and how much memory it has free."""

import os

import jax

from jaxurban.errors import InputError, one_of
from jaxurban.progress import LOG

DEVICES = ("auto", "cpu", "gpu")
PREALLOCATE = "XLA_PYTHON_CLIENT_PREALLOCATE"


def use_device(name: str) -> None:
    """Let JAX compute on a device, before its first use; worker processes of this one will too.

    Args:
      name: ``"cpu"``, ``"gpu"``, or ``"auto"`` for a GPU where JAX finds one, else the CPU.

    Raises:
      InputError: another name, or no GPU that JAX can use.
    """
    one_of("device", name, DEVICES)
    if name == "cpu":
        os.environ["JAX_PLATFORMS"] = "cpu"
        jax.config.update("jax_platforms", "cpu")
    if name == "gpu" and jax.default_backend() == "cpu":
        raise InputError(
            "there is no GPU that JAX can use: install jaxurban[cuda13] (or cuda12) and NVIDIA's driver, or leave "
            "--device out"
        )
    told = f"device: {jax.local_devices()[0].device_kind} ({jax.default_backend()})"
    if (free := gpu_free_bytes()) is not None:
        taken = "as needed" if os.environ.get(PREALLOCATE, "true").lower() in ("false", "0") else "at once"
        told += f", {free / 2**30:,.0f} GiB of memory, taken {taken}"
    LOG.info(told)


def gpu_free_bytes() -> int | None:
    """Return how much memory JAX may still take on its GPU; None where it computes on a CPU."""
    if jax.default_backend() == "cpu":
        return None
    stats = jax.local_devices()[0].memory_stats() or {}
    return int(stats["bytes_limit"] - stats.get("bytes_in_use", 0)) if "bytes_limit" in stats else None
