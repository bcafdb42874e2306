"""Compiles every kernel for an H200 on a machine without one, and holds what it would launch against a kept table.

``make cuda-compile`` runs it, in an environment of its own with the compiler (`constraints-cuda.txt`). A kernel that
launches many more kernels than before, gets a loop whose end is data or needs more temporary memory is named, and the
exit status is 1. So it is where a kernel does not compile, is not in the table (`cuda_compile.json`; ``--write`` keeps
the numbers of this run), or is a function made by `kept_jit` that is not in the list of `cuda_kernels`. ``--only WORD``
looks at kernels whose name holds a word.
"""

import argparse
import importlib
import json
import os
import pkgutil
import re
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import jax
import numpy as np
from jax.experimental import topologies

import jaxurban
from benchmarks.cuda_kernels import KERNELS, Call

# XLA's own matrix products need a GPU to try tiles on, and some do not compile without: NVIDIA's library makes them.
OPTIONS = {"xla_gpu_enable_triton_gemm": False}
PACKAGES = ("kernels", "maps", "metrics", "planners", "studies", "world")
KEPT = Path(__file__).with_name("cuda_compile.json")
ALLOWED = {  # of a kept number, and what it is: XLA's releases fuse a little differently
    "launches": (lambda kept: 1.1 * kept + 2, "launches"),
    "data_loops": (lambda kept: kept, "loops whose end is data"),
    "temporary_mib": (lambda kept: 1.1 * kept + 1, "MiB of temporary memory"),
}
# Instructions for which nothing runs on the GPU: names, views, and the ends of what was begun before.
FREE = (
    *(
        "parameter",
        "constant",
        "get-tuple-element",
        "tuple",
        "bitcast",
        "after-all",
        "add-dependency",
        "opt-barrier",
    ),
    *("domain", "partition-id", "replica-id", "copy-done", "async-update", "async-done"),
)
Numbers = dict[str, float]

# What XLA must know of the GPU (its stream_executor's GpuTargetConfigProto): an H200 by NVIDIA's data sheet.
H200 = """
platform_name: "CUDA"
device_description_str: "NVIDIA H200"
dnn_version_info { major: 9 minor: 12 }
runtime_version { major: 13 minor: 0 }
gpu_device_info {
  cuda_compute_capability { major: 9 }
  core_count: 132
  fpus_per_core: 128
  clock_rate_ghz: 1.98
  memory_bandwidth: 4800000000000
  device_memory_size: 150000000000
  l2_cache_size: 62914560
  threads_per_warp: 32
  threads_per_block_limit: 1024
  threads_per_core_limit: 2048
  block_dim_limit_x: 2147483647
  block_dim_limit_y: 65535
  block_dim_limit_z: 65535
  shared_memory_per_block: 49152
  shared_memory_per_block_optin: 232448
  shared_memory_per_core: 233472
  registers_per_block_limit: 65536
  registers_per_core_limit: 65536
  runtime_version: "13.0.0"
  driver_version: "13.0.0"
}
"""


def h200() -> jax.sharding.Sharding:
    """Return where arrays lie that are wholly on the GPU described above."""
    gpu = topologies.get_topology_desc(platform="cuda", target_config=H200, topology="1x1x1")
    return jax.sharding.NamedSharding(
        topologies.make_mesh(gpu, (1,), ("gpu",)), jax.sharding.PartitionSpec()
    )


def compiled(call: Call, where: jax.sharding.Sharding) -> jax.stages.Compiled:
    """Return the program of a call, compiled for where its arrays lie."""

    def described(leaf: object) -> jax.ShapeDtypeStruct:
        dtype = jax.dtypes.canonicalize_dtype(
            leaf.dtype if hasattr(leaf, "dtype") else np.asarray(leaf).dtype
        )
        return jax.ShapeDtypeStruct(np.shape(leaf), dtype, sharding=where)

    with jax.enable_x64(call.is_float64):
        arguments = jax.tree.map(described, call.arguments)
        return call.function.lower(*arguments, **call.static).compile(OPTIONS)


def count(hlo: str) -> tuple[int, int]:
    """Return what one call of a compiled program launches, and how many of its loops end by data.

    Launches are kernels, copies and library calls: of a loop as many times as it turns, once where its end is data; of
    branches the one with most.

    Args:
      hlo: ``compiled.as_text()`` of a program compiled for a GPU.

    Raises:
      ValueError: the text holds no entry computation.
    """
    parts = re.findall(
        r"^(ENTRY )?%?([\w.\-]+) \([^\n]*\{\n(.*?)^\}", hlo, re.MULTILINE | re.DOTALL
    )
    bodies = {
        name: [line for line in body.splitlines() if " = " in line] for _, name, body in parts
    }
    entry = next((name for is_entry, name, _ in parts if is_entry), None)
    if entry is None:
        raise ValueError("the text holds no ENTRY computation: give compiled.as_text()")

    @cache
    def of(name: str) -> tuple[int, int]:
        launches, loops = zip(*map(one, bodies[name]), strict=True)
        return sum(launches), sum(loops)

    def one(line: str) -> tuple[int, int]:
        opcode = re.search(r" ([a-z][a-z0-9\-]*)\(", line.split(" = ", 1)[1])[
            1
        ]  # before a bracket, behind the type
        if opcode in FREE:
            return 0, 0
        if opcode not in ("while", "conditional", "call"):
            return 1, 0
        called = re.search(r"branch_computations=\{([^}]*)\}", line)
        names = (
            called[1]
            if called
            else " ".join(re.findall(r"(?:body|condition|to_apply|_computation)=(\S+)", line))
        )
        launches, loops = zip(*map(of, re.findall(r"[\w.\-]+", names)), strict=True)
        if opcode == "while":
            known = re.search(r'"known_trip_count":\s*\{\s*"n":\s*"(\d+)"', line)
            return (int(known[1]) if known else 1) * sum(launches), sum(loops) + (known is None)
        return max(launches), sum(loops)

    return of(entry)


def numbers(name: str, where: jax.sharding.Sharding) -> Numbers | str:
    """Return what a kernel launches and holds, or why it does not compile."""
    try:
        program = compiled(KERNELS[name](), where)
    except (
        Exception
    ) as error:  # whatever the compiler refuses: the other kernels are looked at all the same
        return f"{type(error).__name__}: {str(error).strip().splitlines()[0][:300]}"
    launches, data_loops = count(program.as_text())
    held_mib = round(program.memory_analysis().temp_size_in_bytes / 2**20, 1)
    return {"launches": launches, "data_loops": data_loops, "temporary_mib": held_mib}


def faults(name: str, found: Numbers | str, kept: dict[str, Numbers]) -> Iterator[str]:
    """Yield what is wrong with a kernel: by which number it is more CPU-shaped than it was."""
    if isinstance(found, str):
        yield f"{name} does not compile: {found}"
    elif name not in kept:
        yield f"{name} is not in the kept table: look at its numbers and keep them with --write"
    else:
        for key, (limit, meaning) in ALLOWED.items():
            if found[key] > limit(kept[name][key]):
                yield (
                    f"{name} became CPU-shaped: {found[key]:g} {meaning}, where {kept[name][key]:g} are kept and "
                    f"at most {limit(kept[name][key]):g} allowed"
                )


def unlisted(listed: Iterable[object]) -> Iterator[str]:
    """Yield the functions of `PACKAGES` made by `kept_jit` that are not listed."""
    known = set(map(id, listed))
    for package in PACKAGES:
        folder = [str(Path(jaxurban.__path__[0], package))]
        for found in pkgutil.walk_packages(folder, f"jaxurban.{package}."):
            module = importlib.import_module(found.name)
            for name, value in vars(module).items():
                is_own = (
                    hasattr(value, "programs") and getattr(value, "__module__", "") == found.name
                )
                if is_own and id(value) not in known:
                    yield f"{found.name}.{name} is not in the list of kernels (benchmarks/cuda_kernels.py)"


def main() -> int:
    """Compile what the command line asks for; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="keep the numbers of this run")
    parser.add_argument("--only", default="", help="a word of the names to look at")
    options = parser.parse_args()
    jax.config.update("jax_platforms", "cpu")  # the GPU is described, not looked for
    os.environ["JAX_SKIP_CUDA_CONSTRAINTS_CHECK"] = "1"  # of libraries that only a run needs
    begin_s = time.perf_counter()
    names = [name for name in KERNELS if options.only in name]
    where = h200()
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        found = dict(zip(names, threads.map(lambda name: numbers(name, where), names), strict=True))
    print("\n".join(f"{name}: {row}" for name, row in found.items()))
    print(f"{len(found)} kernels compiled for an H200 in {time.perf_counter() - begin_s:.0f} s")
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    if options.write:
        kept = {
            name: row
            for name, row in (kept | found).items()
            if name in KERNELS and not isinstance(row, str)
        }
        KEPT.write_text(
            json.dumps({name: kept[name] for name in KERNELS if name in kept}, indent=1) + "\n"
        )
    wrong = [fault for name in names for fault in faults(name, found[name], kept)]
    if not options.only:
        wrong += unlisted(
            KERNELS[name]().function for name in names if not isinstance(found[name], str)
        )
    if wrong:
        print("\n".join(wrong), file=sys.stderr)
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
