import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.census import read_blocks
from jaxurban.maps.provenance import population_totals
from jaxurban.metrics.population import Population
from jaxurban.world.city import OTHER_DISTRICT, Zoning

CRS = "EPSG:32618"
X0, Y0 = 585_000.0, 4_510_000.0
IDS = ["360610001001000", "360610001001001", "360610001001002"]


def write_blocks(path, ids=IDS, **fields):
    """Write one block of 100 m x 100 m an id, in a row, in NAD83 as the Census does."""
    x = X0 + 100.0 * np.arange(len(ids))
    polygons = shapely.box(x, Y0, x + 100, Y0 + 100)
    frame = gpd.GeoDataFrame({"GEOID10": ids, **fields}, geometry=polygons, crs=CRS).to_crs("EPSG:4269")
    frame.to_parquet(path) if path.suffix == ".parquet" else frame.to_file(path)
    return path


@pytest.fixture
def sf1(tmp_path):
    path = tmp_path / "P1.csv"
    path.write_text(
        '"GEO_ID","NAME","P001001"\n"id","Geographic Area Name","Total"\n'
        f'"1000000US{IDS[0]}","Block 1000, New York County","123(r45678)"\n'
        f'"1000000US{IDS[2]}","Block 1002, New York County","1,400"\n'
        '"1000000US360470001001000","Block 1000, Kings County","7"\n'
    )
    return path


@pytest.mark.parametrize("suffix", [".shp", ".gpkg", ".geojson", ".parquet"])
def test_blocks_of_any_format_join_the_table_of_two_header_rows(tmp_path, sf1, suffix):
    blocks, issues = read_blocks(Population(blocks=write_blocks(tmp_path / f"blocks{suffix}"), table=sf1), CRS)
    assert blocks.block_id.tolist() == IDS
    assert blocks.night_count.tolist() == [123, 0, 1400]
    np.testing.assert_allclose(blocks.area_m2, 1e4, rtol=1e-4)
    assert set(blocks.district) == {OTHER_DISTRICT}
    assert set(blocks.zoning) == {Zoning.OTHER}
    assert {name: number for name, number in issues.items() if number} == {
        "blocks_without_count": 1,
        "blocks_without_district": 3,
        "counts_without_block": 1,
    }


def test_a_plain_table_joins_whatever_its_columns_are_called(tmp_path):
    pd.DataFrame({"people": [1, 2, 3], "name": list("abc"), "block": IDS}).to_csv(tmp_path / "t.csv", index=False)
    blocks, issues = read_blocks(Population(blocks=write_blocks(tmp_path / "b.gpkg"), table=tmp_path / "t.csv"), CRS)
    assert blocks.night_count.tolist() == [1, 2, 3]
    assert issues["counts_without_block"] == issues["blocks_without_count"] == 0


def test_ids_join_also_as_numbers_and_without_their_leading_zero(tmp_path):
    ids = ["060370001001000", "060370001001001"]
    pd.DataFrame({"GEOID": [int(i) for i in ids], "POP100": [5, 6]}).to_csv(tmp_path / "t.csv", index=False)
    blocks, _ = read_blocks(Population(blocks=write_blocks(tmp_path / "b.gpkg", ids), table=tmp_path / "t.csv"), CRS)
    assert blocks.night_count.tolist() == [5, 6]
    assert blocks.block_id.tolist() == ids
    as_numbers, _ = read_blocks(
        Population(blocks=write_blocks(tmp_path / "n.gpkg", [int(i) for i in ids]), table=tmp_path / "t.csv"), CRS
    )
    assert as_numbers.night_count.tolist() == [5, 6]


def test_counts_can_lie_in_the_blocks_file(tmp_path):
    path = write_blocks(tmp_path / "b.gpkg", POP10=[4, 5, 6], HOUSING10=[1, 2, 3])
    blocks, _ = read_blocks(Population(blocks=path), CRS)
    assert blocks.night_count.tolist() == [4, 5, 6]
    with pytest.raises(InputError, match=r"no field of population .* set \[population\] table"):
        read_blocks(Population(blocks=write_blocks(tmp_path / "c.gpkg")), CRS)


def test_an_unreadable_count_is_counted_and_taken_as_nobody(tmp_path):
    pd.DataFrame({"id": IDS, "population": ["1", "n/a", "-4"]}).to_csv(tmp_path / "t.csv", index=False)
    blocks, issues = read_blocks(Population(blocks=write_blocks(tmp_path / "b.gpkg"), table=tmp_path / "t.csv"), CRS)
    assert blocks.night_count.tolist() == [1, 0, 0]
    assert issues["blocks_without_count"] == 2


def test_only_blocks_that_touch_the_region_are_kept(tmp_path, sf1):
    blocks, issues = read_blocks(
        Population(blocks=write_blocks(tmp_path / "b.shp"), table=sf1),
        CRS,
        bounds_m=(X0 + 210, Y0 + 10, X0 + 900, Y0 + 90),
    )
    assert blocks.block_id.tolist() == IDS[2:]
    assert issues["counts_without_block"] == 1  # against the whole file, not the region
    with pytest.raises(InputError, match="no block that touches the region"):
        read_blocks(Population(blocks=tmp_path / "b.shp", table=sf1), CRS, bounds_m=(0, 0, 10, 10))


def test_districts_set_label_and_zoning(tmp_path, sf1):
    districts = gpd.GeoDataFrame(
        {"BoroCD": [101, 107]}, geometry=shapely.box([X0, X0 + 160], Y0, [X0 + 160, X0 + 200], Y0 + 100), crs=CRS
    )
    districts.to_file(tmp_path / "d.gpkg")
    blocks, issues = read_blocks(
        Population(
            blocks=write_blocks(tmp_path / "b.gpkg"), table=sf1, districts=tmp_path / "d.gpkg", commercial=(101,)
        ),
        CRS,
    )
    assert blocks.district.tolist() == [101, 101, OTHER_DISTRICT]
    assert blocks.zoning.tolist() == [Zoning.COMMERCIAL, Zoning.COMMERCIAL, Zoning.OTHER]
    assert issues["blocks_without_district"] == 1


def test_a_wrong_block_field_is_refused_with_the_remedy(tmp_path, sf1):
    path = write_blocks(tmp_path / "b.gpkg", TRACT=["1", "1", "2"], NAME=["x", "y", "z"])
    with pytest.raises(InputError, match=r"no field 'GEOID20' .did you mean 'GEOID10'"):
        read_blocks(Population(blocks=path, table=sf1, block_field="GEOID20"), CRS)
    with pytest.raises(InputError, match="id '1' more than once in 'TRACT'"):
        read_blocks(Population(blocks=path, table=sf1, block_field="TRACT"), CRS)
    with pytest.raises(InputError, match="joins no block: no column holds ids such as 'x'"):
        read_blocks(Population(blocks=path, table=sf1, block_field="NAME"), CRS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "cannot be read as CSV"),
        ("id,population\n", "joins no block"),
        (f"id,a,b\n{IDS[0]},1,2\n", "name one of 'a', 'b' 'population'"),
        (f"id,population\n{IDS[0]},1\n{IDS[0]},2\n", "more than one count for the block"),
    ],
)
def test_a_table_that_cannot_serve_says_why(tmp_path, text, message):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_blocks(Population(blocks=write_blocks(tmp_path / "b.gpkg"), table=tmp_path / "t.csv"), CRS)


def test_missing_files_are_named(tmp_path, sf1):
    with pytest.raises(InputError, match=r"the blocks file .*none.shp' does not exist"):
        read_blocks(Population(blocks=tmp_path / "none.shp", table=sf1), CRS)
    with pytest.raises(InputError, match=r"\[population\] table .*none.csv' does not exist"):
        read_blocks(Population(blocks=write_blocks(tmp_path / "b.gpkg"), table=tmp_path / "none.csv"), CRS)


def test_repeated_equal_rows_count_once(tmp_path):
    (tmp_path / "t.csv").write_text(f"id,population\n{IDS[0]},9\n{IDS[0]},9\n")
    blocks, _ = read_blocks(Population(blocks=write_blocks(tmp_path / "b.gpkg"), table=tmp_path / "t.csv"), CRS)
    assert blocks.night_count.tolist() == [9, 0, 0]


@pytest.mark.data
def test_manhattan_has_its_census_by_district(data_dir):
    blocks, issues = read_blocks(
        Population(
            blocks=data_dir / "census/tl_2010_36061_tabblock10.shp",
            table=data_dir / "census/DECENNIALSF12010.P1_nyc_blocks.csv",
            districts=data_dir / "districts/nyc_community_districts.geojson",
        ),
        CRS,
    )
    assert len(blocks) == 3950
    assert issues["blocks_without_count"] == 0
    night = population_totals(blocks)["night"]
    assert night == {"commercial": 611_934, "residential": 965_451, "other": 8_488, "total": 1_585_873}
    assert blocks.night_count[blocks.district == 164].sum() == 25
    assert set(blocks.district) >= {*range(101, 113), 164, OTHER_DISTRICT}
