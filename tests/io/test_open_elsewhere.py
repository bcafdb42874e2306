"""What is written opens in others' hands: xarray, rioxarray, GDAL and QGIS, values equal to the maps'."""

import os
import re
import resource
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import matplotlib
import numpy as np
import pyproj
import pytest
import rasterio
import xarray as xr
from rasterio.shutil import copy

import jaxurban as ju
from jaxurban.draw import metrics as figures
from jaxurban.io.files import whole_file
from jaxurban.io.geotiff import BLOCK, ramp_of, raster_profile, write_cog, write_geotiffs
from jaxurban.io.store import write_zarr
from jaxurban.maps.build import compute_maps
from jaxurban.metrics.custom import Layer, check_layers, held_variables
from tests import tiled_runs
from tests.cli_runs import TOWN, run
from tests.tiled_runs import files_of

rioxarray = pytest.importorskip("rioxarray", reason="needs the dev extra")
rio_cogeo = pytest.importorskip("rio_cogeo", reason="needs the dev extra")

# rioxarray writes affine's products as * .
pytestmark = pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    """Two times, two altitudes, on terrain, with a hole in the data and obstacles."""
    made = compute_maps(tiled_runs.task(tiled_runs.city(with_terrain=True)))
    made.ds.attrs["attribution"] = "© those who measured it"
    return made


@pytest.fixture(scope="module")
def folder(maps, tmp_path_factory) -> Path:
    return maps.save(tmp_path_factory.mktemp("maps"), layers=("all",))


@pytest.fixture(scope="module")
def opened(folder) -> xr.Dataset:
    return xr.open_zarr(folder / "maps.zarr/20m")


@pytest.mark.filterwarnings("ignore:Consolidated metadata")  # of zarr, which xarray writes
@pytest.mark.parametrize("zarr_format", [2, 3])
def test_opened_maps_are_written_by_xarray_in_either_format_of_zarr(folder, tmp_path, zarr_format):
    own = ju.open_maps(folder).ds
    own.to_zarr(tmp_path / "copy.zarr", zarr_format=zarr_format)
    with xr.open_zarr(tmp_path / "copy.zarr") as copied:
        assert {*copied.data_vars} == {*own.data_vars}
        for name, values in own.data_vars.items():
            assert np.array_equal(copied[name].values, values.values, equal_nan=True), name


def expected(maps: ju.MetricMaps, name: str, **at: int) -> np.ndarray:
    """Return a map as files hold it, rows from the north, NaN where they hold nothing."""
    return maps.ds[name].isel(at).values.astype(np.float64)[..., ::-1, :]


@pytest.mark.slow
def test_what_is_read_back_has_the_bits_of_what_was_held(maps, folder):
    found = ju.open_maps(folder).ds.load()
    xr.testing.assert_identical(found, maps.ds)
    for name, array in maps.ds.data_vars.items():
        assert (found[name].dtype, found[name].values.tobytes()) == (
            array.dtype,
            array.values.tobytes(),
        ), name


@pytest.mark.slow
def test_values_and_axes_of_ones_own_are_read_back(maps, tmp_path):
    changed = maps.ds.isel(time=[0]).transpose(..., "altitude", "time", "y", "x").copy(deep=True)
    inside = (changed["obstacle"].values[0] != 0) & changed["has_data"].values
    for name in ("gps", "lidar"):
        changed[name].values[changed[name].values == 0] = -0.0
    changed["gps"].values[0, 0][inside] = np.nan
    changed["lidar"].values[0][inside] = 0.25
    ju.MetricMaps(changed).save(tmp_path)
    found = ju.open_maps(tmp_path).ds
    for name, array in changed.data_vars.items():
        assert found[name].dims == array.dims
        assert found[name].values.tobytes() == np.ascontiguousarray(array.values).tobytes(), name


def test_maps_are_saved_beside_those_of_a_resolution_that_cannot_be_read(maps, tmp_path):
    for name, text in (("5m/zarr.json", "{}"), ("10m/.zmetadata", "{junk")):
        (tmp_path / "maps.zarr" / name).parent.mkdir(parents=True)
        (tmp_path / "maps.zarr" / name).write_text(text)
    xr.testing.assert_identical(ju.open_maps(maps.save(tmp_path), 20).ds.load(), maps.ds)


def test_maps_saved_into_the_folder_that_they_were_opened_from_stay_usable(maps, tmp_path):
    opened = ju.open_maps(maps.save(tmp_path))
    opened.ds["noise"] = 2 * opened.ds["roof"]
    opened.save(tmp_path)
    xr.testing.assert_identical(opened.ds["roof"].load(), maps.ds["roof"])
    assert ju.open_maps(tmp_path).ds["noise"].identical(opened.ds["noise"])
    assert opened.folder == tmp_path


@pytest.mark.parametrize(
    ("change", "layers", "words"),
    [
        (lambda ds: ds.drop_vars("obstacle"), (), "lack obstacle"),
        (lambda ds: ds.assign({"a/b": ds["roof"]}), (), "'a/b' cannot be written"),
        (lambda ds: ds, ("hdpo",), "hdop"),
    ],
)
def test_what_nothing_could_open_is_refused_before_anything_is_written(
    maps, tmp_path, change, layers, words
):
    with pytest.raises(ju.InputError, match=words):
        ju.MetricMaps(change(maps.ds)).save(tmp_path / "out", layers=layers)
    assert not (tmp_path / "out").exists()


def test_xarray_opens_the_group(maps, folder, opened):
    assert list(opened["y"].values) == list(maps.grid.y_m[::-1])
    np.testing.assert_array_equal(opened["time"].values, maps.ds["time"].values)
    assert (maps.ds["obstacle"].values != 0).any()
    assert not maps.ds["has_data"].values.all()
    for name in maps.ds.data_vars:
        np.testing.assert_array_equal(
            opened[name].values.astype(np.float64), expected(maps, str(name)), str(name)
        )


@pytest.fixture(scope="module")
def whole(maps, tmp_path_factory) -> Path:
    """Save maps and, as of another resolution, those of half of their region, and return where all of them lie."""
    folder = maps.save(tmp_path_factory.mktemp("whole"))
    part = maps.ds.isel(y=slice(0, 19), x=slice(3, 30)).assign_attrs(resolution_m=10.0)
    write_zarr(part.drop_vars(["y", "x"]), folder)
    return folder / "maps.zarr"


def test_xarray_opens_a_group_of_the_whole_and_all_of_them(whole, opened):
    xr.testing.assert_identical(xr.open_zarr(whole, group="20m").load(), opened.load())
    tree = xr.open_datatree(whole, engine="zarr")
    assert sorted(tree.children) == ["10m", "20m"]
    xr.testing.assert_identical(tree["20m"].to_dataset().load(), opened)
    assert tree["10m"].sizes["y"] == 19


def test_what_xarray_opens_is_written_as_netcdf(opened, tmp_path):
    """By SciPy, which the package brings: NetCDF 3, without unsigned numbers."""
    opened.to_netcdf(tmp_path / "maps.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "maps.nc", engine="scipy") as found:
        xr.testing.assert_equal(found.load(), opened.load())


def test_all_resolutions_are_written_as_one_netcdf(whole, opened, tmp_path):
    pytest.importorskip("h5netcdf", reason="needs the dev extra")
    tree = xr.open_datatree(whole, engine="zarr")
    tree.to_netcdf(tmp_path / "maps.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "maps.nc", engine="h5netcdf") as found:
        xr.testing.assert_equal(found["20m"].to_dataset().load(), opened.load())
        assert sorted(found.children) == ["10m", "20m"]


def test_what_xarray_opens_says_what_it_is(opened):
    assert opened.attrs["Conventions"].startswith("CF-")
    height = {
        "standard_name": "height",
        "long_name": "above ground",
        "axis": "Z",
        "units": "m",
        "positive": "up",
    }
    assert opened["altitude"].attrs.items() >= height.items()
    assert opened["time"].encoding["units"].startswith("seconds since")
    for name, array in opened.data_vars.items():
        assert array.attrs["long_name"], name
        assert array.attrs["grid_mapping"] == "spatial_ref"
        assert "units" in array.attrs or name == "has_data"
    assert pyproj.CRS.from_cf(opened["spatial_ref"].attrs) == pyproj.CRS(opened.attrs["crs"])


def test_a_raster_written_by_rioxarray_is_north_up(maps, opened, tmp_path):
    opened["gps"].isel(time=1, altitude=0).rio.to_raster(tmp_path / "gps.tif")
    with rasterio.open(tmp_path / "gps.tif") as file:
        assert (file.transform.a, file.transform.e) == (20.0, -20.0)
        assert file.bounds == maps.grid.bounds_m
        assert file.crs == rasterio.crs.CRS.from_user_input(maps.grid.crs)
        np.testing.assert_array_equal(file.read(1), expected(maps, "gps", time=1, altitude=0))


def test_gdal_opens_every_map_of_the_zarr(maps, folder):
    for name, array in maps.ds.data_vars.items():
        for index in np.ndindex(array.shape[:-2]):
            place = "".join(f":{part}" for part in index)
            at = dict(zip(array.dims, index, strict=False))
            for whole, group in ((folder / "maps.zarr/20m", ""), (folder / "maps.zarr", "/20m")):
                with rasterio.open(f'ZARR:"{whole}":{group}/{name}{place}') as file:
                    assert file.bounds == maps.grid.bounds_m
                    assert file.crs == rasterio.crs.CRS.from_user_input(maps.grid.crs)
                    found = file.read(1, masked=True).astype(np.float64).filled(np.nan)
                np.testing.assert_array_equal(found, expected(maps, str(name), **at), str(name))


def test_every_map_is_a_valid_cog_that_says_what_it_is(maps, folder):
    files = sorted((folder / "geotiff").glob("*.tif"))
    assert len(files) == sum(int(np.prod(array.shape[:-2])) for array in maps.ds.data_vars.values())
    for path in files:
        assert rio_cogeo.cog_validate(path, strict=True, quiet=True) == (True, [], []), path.name
        with rasterio.open(path) as file:
            tags, name = file.tags(), file.tags()["metric"]
            array = maps.ds[name]
            assert tags["credit"] == maps.ds.attrs["attribution"]
            assert file.descriptions[0].startswith(tags["long_name"])
            assert (file.units[0] or "") == tags.get("units", "")
            at = {}
            if "altitude" in array.dims:
                at["altitude"] = maps.altitudes_m.index(float(tags["altitude_m"]))
                assert f"{tags['altitude_m']} m above ground" in file.descriptions[0]
            if "time" in array.dims:
                at["time"] = maps.times.index(tags["time"])
                assert tags["constellation"] == "gps"
            values = expected(maps, name, **at)
            if name != "has_data":
                values[~maps.ds["has_data"].values[::-1]] = np.nan
            if array.dtype in (np.uint8, np.bool_):
                assert (file.dtypes[0], file.nodata) == ("uint8", 255)
            found = file.read(1, masked=True).astype(np.float64).filled(np.nan)
            np.testing.assert_array_equal(found, values, path.name)


def test_large_maps_have_overviews_and_those_of_obstacles_are_no_averages(maps, tmp_path):
    big = maps.ds[["obstacle", "gps", "lidar", "risk", "has_data"]].isel(altitude=[0], time=[0])
    big = xr.concat([xr.concat([big.drop_vars(["y", "x"])] * 14, "y")] * 27, "x")
    for path in (path for path in write_geotiffs(big, tmp_path) if path.suffix == ".tif"):
        with rasterio.open(path) as file:
            assert file.overviews(1) == [2, 4]
            small = file.read(1, out_shape=(file.height // 4, file.width // 4))
        assert "obstacle" not in path.name or set(np.unique(small)) <= {0, 1, 255}


COLOURED = [
    "gps",
    "lidar",
    "risk",
    "population",
    "hdop",
    "num_visible",
    "density",
    "roof",
    "roof_touched",
]


@pytest.fixture(scope="module")
def styled(tmp_path_factory):
    """Return maps of a city of outlines, and their styles."""
    maps = compute_maps(tiled_runs.task(tiled_runs.city()))
    files = write_geotiffs(maps.ds, tmp_path_factory.mktemp("styles"), layers=("all",))
    styles = {path.stem: path for path in files if path.suffix == ".qml"}
    assert len(styles) == len(maps.ds.data_vars)
    return maps, styles


@pytest.mark.parametrize("name", COLOURED)
def test_styles_are_the_colours_of_the_figures(name, styled):
    maps, styles = styled
    renderer = ET.parse(styles[f"{name}_20m"]).getroot().find("pipe/rasterrenderer")
    assert renderer.get("type") == "singlebandpseudocolor"
    items = [(float(item.get("value")), item.get("color")) for item in renderer.iter("item")]
    shown = figures.metric_colours(maps, name)
    assert (items[0][0], items[-1][0]) == pytest.approx((shown.norm.vmin, shown.norm.vmax))
    values = np.linspace(items[0][0], items[-1][0], 200)
    stops = np.array([matplotlib.colors.to_rgb(colour) for _, colour in items])
    ours = np.stack(
        [np.interp(values, [value for value, _ in items], stops[:, i]) for i in range(3)], axis=1
    )
    theirs = matplotlib.colormaps.get_cmap(shown.cmap)(shown.norm(values))[:, :3]
    np.testing.assert_allclose(
        ours, theirs, atol=0.07
    )  # a logarithm is linear between 17 places only by and by


def test_obstacles_are_shown_as_two_classes(folder):
    entries = ET.parse(folder / "geotiff" / "obstacle_20m.qml").getroot().findall(".//paletteEntry")
    assert [(entry.get("value"), entry.get("label")) for entry in entries] == [
        ("0", "free"),
        ("1", "obstacle"),
    ]


def test_a_range_ignores_dops_without_a_fix(maps):
    assert np.isinf(maps.ds["hdop"].values).any()
    variables = held_variables(maps.ds)
    assert ramp_of(maps.ds, variables["hdop"])[0][-1] == 20.0
    assert np.isfinite(ramp_of(maps.ds, variables["terrain"])[0]).all()


@pytest.mark.parametrize("layout", ["zarr", "run.json", "copy"])
def test_maps_of_another_version_are_refused_everywhere_with_the_one_remedy(
    folder, tmp_path, capsys, layout
):
    old = tmp_path / "old"
    if layout == "copy":
        shutil.copytree(folder, old)
        (old / "checksums.json").unlink()
    else:
        file, text = {
            "zarr": ("maps.zarr/20m/zarr.json", "{}"),
            "run.json": ("run.json", '{"run_key": "a"}'),
        }[layout]
        (old / file).parent.mkdir(parents=True)
        (old / file).write_text(text)
    before = files_of(old)
    lacks, is_in_way = "holds no metric maps, or not their checksums.json", "is in the way"
    with pytest.raises(ju.InputError, match=lacks):
        ju.open_maps(old)
    (tmp_path / "a.toml").write_text(TOWN)
    maps = "maps", tmp_path / "a.toml", "-o", old
    commands = (("info", old), lacks), (maps, is_in_way), ((*maps, "--overwrite"), is_in_way)
    for command, words in commands:
        code, _, err = run(capsys, *command)
        assert (code, re.search(words, err) is not None) == (2, True), err
    assert files_of(old) == before


@pytest.mark.parametrize(
    "name", ["noise_20m", "population_day", "gps_20m_20200427T160000Z", "risk_60m"]
)
def test_a_layer_with_the_name_of_anothers_file_is_refused(name):
    flat = Layer(np.zeros((2, 2)), "high-is-bad", (0, 1))
    with pytest.raises(ju.InputError, match=f"cannot be called '{name}': maps, their files"):
        check_layers({name: flat})
    check_layers({"noise_m": flat, "day_noise": flat})


CORNER = "EPSG:32618", 2.5, 1_800_000, 230_000
TAGS = {"metric": "gps", "credit": "© those who measured it"}


def map_of(shape: tuple[int, int], dtype: type) -> np.ndarray:
    values = np.random.default_rng(1).random(shape, np.float32)
    if dtype == np.uint8:
        return np.array([0, 1, 255], np.uint8)[(3 * values).astype(int)]
    return np.where(values < 0.2, np.nan, values)


def write(path, values: np.ndarray, is_averaged: bool, num_rows: int = BLOCK) -> None:
    parts = (values[start : start + num_rows] for start in range(0, len(values), num_rows))
    about = {"is_averaged": is_averaged, "tags": TAGS, "title": "GPS quality", "unit": "1"}
    write_cog(path, ju.Grid(*CORNER, *values.shape), values.dtype, parts, **about)


def facts_of(path) -> list:
    with rasterio.open(path) as file:
        facts = [
            {name: str(value) for name, value in file.profile.items()},
            file.read(1).tobytes(),
            file.overviews(1),
        ]
        facts += [file.tags(), file.tags(ns="IMAGE_STRUCTURE"), file.descriptions, file.units]
    for level in range(len(facts[2])):
        with rasterio.open(path, overview_level=level) as file:
            facts += [file.shape, str(file.nodata), file.block_shapes, file.read(1).tobytes()]
    return facts


@pytest.mark.parametrize(
    ("shape", "dtype", "is_averaged"),
    [
        ((40, 30), np.float32, True),
        ((512, 512), np.float32, True),
        ((513, 40), np.uint8, False),
        ((1301, 1023), np.float32, True),
        ((1024, 1536), np.float32, False),
        ((700, 2100), np.uint8, False),
    ],
)
def test_a_file_is_that_of_gdals_cog_driver(tmp_path, shape, dtype, is_averaged):
    values = map_of(shape, dtype)
    with rasterio.open(
        tmp_path / "plain.tif", "w", **raster_profile(ju.Grid(*CORNER, *shape), values.dtype)
    ) as file:
        file.write(values, 1)
        file.update_tags(**TAGS)
        file.set_band_description(1, "GPS quality")
        file.set_band_unit(1, "1")
    how = {"compress": "ZSTD", "level": 1, "blocksize": 512}
    how["overview_resampling"] = "average" if is_averaged else "nearest"
    copy(tmp_path / "plain.tif", tmp_path / "gdal.tif", driver="COG", **how)
    write(tmp_path / "ours.tif", values, is_averaged)
    assert facts_of(tmp_path / "ours.tif") == facts_of(tmp_path / "gdal.tif")
    assert rio_cogeo.cog_validate(tmp_path / "ours.tif", strict=True, quiet=True) == (True, [], [])


def test_a_file_does_not_depend_on_how_many_rows_come_at_a_time_and_leaves_nothing_beside_it(
    tmp_path,
):
    values = map_of((1301, 700), np.float32)
    write(tmp_path / "a.tif", values, True)
    write(tmp_path / "b.tif", values, True, 1024)
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"a.tif", "b.tif"}


def test_a_disk_that_is_full_at_any_point_is_an_os_error(tmp_path):
    values = np.random.default_rng(1).random(
        (1024, 1024), np.float32
    )  # as noise, which no compression makes smaller
    write(tmp_path / "whole.tif", values, True)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    num_bytes = (tmp_path / "whole.tif").stat().st_size
    for most_bytes in [
        *range(0, num_bytes, 150_000),
        num_bytes - 5,
        num_bytes - 4096,
        num_bytes - 65536,
    ]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, limits[1]))
        try:
            with pytest.raises(OSError, match="File too large"):
                write(tmp_path / "a.tif", values, True)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.skipif(os.getuid() != 0, reason="only root mounts a disk of some kilobytes")
@pytest.mark.parametrize("size", ["100k", "1500k"])  # too small for the map, and for its overviews
def test_a_geotiff_says_that_the_disk_is_full_and_leaves_nothing(tmp_path, size):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", disk]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("nothing can be mounted here")
    try:
        values = np.random.default_rng(1).random((400, 500), np.float32)
        with (
            pytest.raises(ju.InputError, match="No space left on device; free space there"),
            whole_file(disk / "a.tif") as scratch,
        ):
            write(scratch, values, True)
        assert not [*disk.iterdir()]
    finally:
        subprocess.run(["umount", disk], check=True)
