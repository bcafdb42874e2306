"""Heights that a model estimated: which these are by what a table says of them, and how high they may truly be.

Words and columns are those of Microsoft's footprints (github.com/microsoft/GlobalMLBuildingFootprints), Google's
(sites.research.google/gr/open-buildings), the Global Building Atlas (github.com/zhu-xlab/GlobalBuildingAtlas),
3D-GloBFP (doi:10.5194/essd-16-5357-2024, by the file's name alone), EUBUCCO (docs.eubucco.com, data schema), Overture
Maps (docs.overturemaps.org, sources of a feature and of its properties), OpenStreetMap
(wiki.openstreetmap.org/wiki/Key:source:height), INSPIRE (Data Specification on Buildings, HeightStatusValue) and
Germany's (AdV, DatenquelleDachhoehe).
"""

import json
import re
from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd

from jaxurban.cities.heights import is_given, parse_length_m, read_column

# Columns by their names as in `columns.COLUMNS`, those of ten letters as Shapefiles cut them.
METHODS = (
    *("height_source", "source_height", "height_method", "height_origin", "height_status"),
    *("heightsource", "height_src", "src_height", "heightmethod", "height_provenance"),
    *(
        "method",
        "hgt_source",
        "hgt_src",
        "h_source",
        "height_type",
        "roof_height_source",
        "height_quality",
    ),
    *("height_sou", "source_hei", "height_met", "height_ori", "height_sta"),
    *("heightaboveground_status", "datenquelledachhoehe", "dqdach"),
)
UNSAID = ("unknown", "none", "n/a", "na", "-", "?")  # words of a method that say nothing
SOURCES = "sources"  # of Overture
VARIANCE = "var"  # in square metres
UPPER = "height_confidence_upper"
FIGURES = (
    *("confidence", "height_confidence", "height_con", "confidence_score", VARIANCE, UPPER),
    *("variance", "height_variance", "height_std"),
)  # which models give
# Data sets of estimates, by their names or a file's.
DATA_SETS = (
    "microsoft|msft|google.?open|open.?buildings|ghs.?built|wsf.?3d|globfp|global.?building.?atlas|"
    "global.?ml.?building"
)
# What a method or a source says of a model, and of no survey; 2000 and 3000 are Germany's codes of heights by storeys
# and by default.
MODEL = re.compile(
    "estim|predict|(?:^|_)pred(?:_|$)|(?:^|_)est(?:_|$)|(?:^|_)ml(?:_|$)|infer|imput|guess|default|assum|schätz|schaetz|geschat|推定|neural|machine|deep.?learn|regress|"
    "random.?forest|xgboost|sentinel|ghs|wsf|google|simulat|interpol|u-?net|\\b(?:ml|ai|cnn)\\b|^doi:|"
    "^(?:modell?(?:ed)?|[23]000(?:\\.0)?)$|" + DATA_SETS,
    re.IGNORECASE,
)
MOST_OF_NORMAL = 2.33  # standard deviations below which 99 % of a normal distribution end


def with_estimates(
    tags: dict[str, np.ndarray],
    values: Mapping[str, np.ndarray],
    file_name: str = "",
    height_column: str = "",
) -> dict[str, np.ndarray]:
    """Return tags with ``estimated_to_m`` if any height is estimated: how high each may truly be, as far as it says.

    What first says where a height is from decides, row by row: its method, its source, a figure that models give, the
    name of the column or of the file. Without such a word it is measured, or said, and ``estimated_to_m`` is None; it
    is 0 where a model says nothing of its errors.

    Args:
      tags: ``[N]`` each, as of `columns.tags_of`.
      values: ``[N]`` columns by plain name, without figures of a publisher whose heights are measured.
      file_name, height_column: of a table.
    """
    is_estimated = _is_of_model(values, file_name, height_column)
    if not is_estimated.any():
        return tags
    missing = np.full(len(is_estimated), np.nan)
    height_m = read_column(tags.get("height", missing), parse_length_m)
    upper_m = read_column(values.get(UPPER, missing), parse_length_m)
    variance_m2 = read_column(values.get(VARIANCE, missing), parse_length_m)
    spread_m = np.sqrt(np.fmax(variance_m2, 0.0))
    most_m = np.fmax(upper_m, height_m + MOST_OF_NORMAL * spread_m)
    estimated_to_m = np.full(len(is_estimated), None, object)
    estimated_to_m[is_estimated] = np.nan_to_num(most_m)[is_estimated]
    return {**tags, "estimated_to_m": estimated_to_m}


def names_estimates(file_name: str) -> bool:
    """Return whether a file has the name of a data set of estimates."""
    return re.search(DATA_SETS, file_name, re.IGNORECASE) is not None


def _is_of_model(
    values: Mapping[str, np.ndarray], file_name: str, height_column: str
) -> np.ndarray:
    """Return ``[N]`` whether a model estimated heights, by the first word that says where each is from."""
    num = len(next(iter(values.values()), ()))
    words = np.full(num, None, object)
    for origin in _origins(values):
        words = np.where(is_given(words), words, origin)
    is_said = is_given(words)
    is_of_model = np.zeros(num, bool)
    is_of_model[is_said] = [MODEL.search(str(word).strip()) is not None for word in words[is_said]]
    if MODEL.search(height_column) or names_estimates(file_name):
        is_of_model |= ~is_said
    return is_of_model


def _origins(values: Mapping[str, np.ndarray]) -> Iterator[np.ndarray]:
    """Yield ``[N]`` what each column that is there says of where heights are from, blank where it says nothing."""
    for name in METHODS:
        if name in values:
            words = pd.Series(values[name], dtype=object)
            yield words.mask(words.astype(str).str.lower().isin(UNSAID)).to_numpy()
    if SOURCES in values:
        yield np.array([_dataset_of(text) for text in values[SOURCES]], object)
    for name in FIGURES:
        if name in values:
            yield pd.Series(is_given(values[name])).map({True: "estimated"}).to_numpy(object)


def _dataset_of(text: object) -> str | None:
    """Return the data set of a height by Overture's list of sources: of that property, else of the whole feature."""
    try:
        sources = json.loads(str(text))
        datasets = {source.get("property") or "": source["dataset"] for source in sources}
    except (ValueError, TypeError, LookupError, AttributeError):
        return None
    return datasets.get("/properties/height", datasets.get(""))
