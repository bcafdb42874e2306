"""What is counted in a compiled program, on one whose launches can be counted by hand, and what the gate lets pass."""

import pytest

from benchmarks.cuda_compile import count, faults, unlisted
from benchmarks.cuda_kernels import KERNELS

# Twelve turns of a kernel and one for the condition; within each turn a loop whose end is data, of one kernel and none
# for its condition; then a branch of three kernels or one, a copy, and a call of one kernel.
PROGRAM = """HloModule jit_f, is_scheduled=true, entry_computation_layout={(f32[8]{0})->f32[8]{0}}

%few (p: f32[8]) -> f32[8] {
  ROOT %one = f32[8]{0} fusion(%p), kind=kLoop, calls=%fused
}

%end (s: (s32[], f32[8])) -> pred[] {
  ROOT %is_on = pred[] bitcast(%s)
}

%outer (s: (s32[], f32[8])) -> (s32[], f32[8]) {
  %s = (s32[], /*index=1*/f32[8]{0:S(5)}) parameter(0)
  %first = f32[8]{0} fusion(%s), kind=kLoop, calls=%fused
  %loop = (s32[], f32[8]{0}) while(%s), condition=%end, body=%few
  ROOT %t = (s32[], f32[8]{0}) tuple(%first, %loop)
}

%many (p: f32[8]) -> f32[8] {
  %k.1 = f32[8]{0} fusion(%p), kind=kLoop, calls=%fused
  %k.2 = (f32[8]{0}, u8[16]{0}) custom-call(%k.1), custom_call_target="__cublas$gemm"
  ROOT %k.3 = f32[8]{0} fusion(%k.2), kind=kInput, calls=%fused
}

ENTRY %main (x: f32[8]) -> f32[8] {
  %x = f32[8]{0} parameter(0)
  %c = s32[] constant(0)
  %l = (s32[], f32[8]{0}) while(%x), condition=%few, body=%outer, backend_config={"known_trip_count":{"n":"12"}}
  %chosen = f32[8]{0} conditional(%c, %x, %x), branch_computations={%many, %few}
  %copied = f32[8]{0} copy(%chosen)
  ROOT %called = f32[8]{0} call(%copied), to_apply=%few
}
"""
ROW = {"launches": 100, "data_loops": 1, "temporary_mib": 10.0}


def test_launches_are_those_of_all_turns_and_of_the_longest_branch():
    assert count(PROGRAM) == (12 * (1 + 1 + 1) + 3 + 1 + 1, 1)
    with pytest.raises(ValueError, match="no ENTRY"):
        count("HloModule jit_f")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"launches": 113}, "113 launches, where 100 are kept and at most 112 allowed"),
        ({"data_loops": 2}, "2 loops whose end is data"),
        ({"temporary_mib": 12.1}, "12.1 MiB of temporary memory"),
    ],
)
def test_a_kernel_that_passes_one_kept_number_is_named_with_it(change, said):
    (fault,) = faults("lidar", ROW | change, {"lidar": ROW})
    assert fault.startswith("lidar became CPU-shaped: ")
    assert said in fault


def test_a_little_more_or_much_less_is_no_fault_but_a_kernel_that_fails_or_is_new_is():
    for row in (ROW | {"launches": 112, "temporary_mib": 12.0}, dict.fromkeys(ROW, 0)):
        assert not list(faults("lidar", row, {"lidar": ROW}))
    assert "does not compile: no tiles" in next(faults("lidar", "no tiles", {"lidar": ROW}))
    assert "not in the kept table" in next(faults("lidar", ROW, {}))


def test_jitted_functions_of_maps_and_surfaces_are_told_where_they_are_not_listed():
    listed = [KERNELS[name]().function for name in ("lidar: a block", "risk")]
    without, with_them = (
        {fault.split(" is not")[0] for fault in unlisted(known)} for known in ([], listed)
    )
    assert without - with_them == {"jaxurban.metrics.lidar._lidar", "jaxurban.metrics.risk._risk"}
