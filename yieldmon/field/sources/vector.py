"""Points in any vector file of GDAL's: GeoPackage, GeoJSON, shapefile, zipped or not; and the zips of the John Deere Operations
Center, whose metadata say the units."""

from __future__ import annotations

import json
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from yieldmon import bounded
from yieldmon.errors import InputError, brief
from yieldmon.field.copies import without_copies
from yieldmon.field.table import Array, HarvestTable, Label, Skipped, joined

from . import isoxml
from .columns.assembled import assemble, labels_from
from .columns.coordinates import to_degrees
from .columns.delimited import UNKNOWN, numbers_in
from .columns.naming import QUANTITIES, Column, columns_of
from .columns.raw_table import Raw
from .damage import ZIP_DAMAGE, may_be_harvest
from .options import ReadOptions

KIND = "GeoPackage, GeoJSON or shapefile"
ORDER = 30
_SUFFIXES = (".gpkg", ".geojson", ".json", ".shp", ".gml", ".fgb", ".kml", ".geojsonl", ".geojsons")
_LARGEST_METADATA_BYTES = 16_000_000
_POSITION = ("longitude", "latitude")
_LOOKED_AT = 5_000
"""Rows, for units that no name says."""
_AT_ONCE = 0.2
"""Share of a layer's seconds that another has too, from which several machines made them."""


def recognises(path: Path, head: bytes) -> bool:
    """By suffix, or a zip with such a file in it."""
    if path.is_dir():
        children = list(path.iterdir())
        return any(child.suffix.lower() == ".shp" for child in children) and not any(
            child.is_dir() or (may_be_harvest(child.name) and child.suffix.lower() != ".shp") for child in children
        )
    if path.suffix.lower() in _SUFFIXES:
        return bool(head)
    return bool(_members(path)) and not _has_others(path)


def _has_others(path: Path) -> bool:
    """Whether a zip may hold other harvests too."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except ZIP_DAMAGE:
        return False
    mine = set(_members(path))
    return any(isoxml.is_task_member(name) or (may_be_harvest(name) and name not in mine) for name in names if not _of_mac(name))


def _of_mac(name: str) -> bool:
    return name.startswith("__MACOSX") or "/__MACOSX/" in name


def is_beside(name: str, shapefile: str) -> bool:
    """Whether a file belongs to a shapefile of the same folder."""
    stem, lower = shapefile.rsplit(".", 1)[0].lower(), name.lower()
    return lower.startswith(f"{stem}.") or (lower.startswith(stem) and lower.endswith("metadata.json"))


def _members(path: Path) -> list[str]:
    if not zipfile.is_zipfile(path):
        return []
    try:
        with zipfile.ZipFile(path) as archive:
            return sorted(
                name for name in archive.namelist() if name.lower().endswith((".shp", ".geojson", ".gpkg")) and not _of_mac(name)
            )
    except ZIP_DAMAGE:
        return []


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """All layers of points that can be read. Raises InputError where there is none."""
    if path.is_dir():
        files = [(str(child), child.name) for child in sorted(path.iterdir()) if child.suffix.lower() == ".shp"]
    elif path.suffix.lower() in _SUFFIXES:
        files = [(str(path), path.name)]
    else:
        files = [(f"/vsizip/{path.absolute()}/{name}", name) for name in _members(path)]
    parts, skipped = _read_layers(path, files, options)
    table = _machines_apart(without_copies(joined(parts)))
    skipped += [one for source in table.sources[1:] for one in source.skipped]
    if len(parts) == 1 and not skipped:
        return table
    first = table.sources[0]
    source = replace(
        first,
        path=str(path),
        points=len(table),
        skipped=(*first.skipped, *skipped),
        notes=tuple(dict.fromkeys(note for one in table.sources for note in one.notes)),
    )
    return replace(table, sources=(source,), source_of_row=np.zeros(len(table), np.int32))


def _read_layers(path: Path, files: Sequence[tuple[str, str]], options: ReadOptions) -> tuple[list[HarvestTable], list[Skipped]]:
    """The layers of points of these files (address, name), or of their other shapes where no points are, and those that cannot
    be read. Raises the first InputError where none can."""
    parts, skipped = list[HarvestTable](), list[Skipped]()
    first: InputError | None = None
    for address, name in files:
        for layers in _layers(address):
            found = []
            for part in layers:
                try:
                    found.append(_layer(path, address, name, part, options))
                except InputError as error:
                    first = first or error
                    skipped.append(Skipped(name if part is None else f"{name}: layer {part}", error.problem))
            parts += found
            if found:
                break
    if not parts:
        raise first or InputError(str(path), "has no layer of points", "a vector file")
    return parts, skipped


@dataclass(frozen=True)
class Metadata:
    """What a sidecar of the Operations Center says."""

    units: Mapping[str, str]
    crop: str = ""
    field: str = ""


@dataclass(frozen=True)
class Layer:
    """What was read: values of each field, points in the layer's own coordinate system (crs), and what was said."""

    names: tuple[str, ...]
    fields: Sequence[np.ndarray]
    x: Array
    y: Array
    crs: str | None
    said: tuple[str, ...]


def _layers(address: str) -> tuple[tuple[str | None, ...], ...]:
    """Names of a file's layers of points, and those of its other shapes, which are rows where no points are.

    A file's only layer is None.
    """
    import pyogrio
    import pyogrio.errors

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = pyogrio.list_layers(address)
    except (pyogrio.errors.DataSourceError, ValueError, RuntimeError, UnicodeError):
        # What is wrong is said by the reading itself.
        return ((None,),)
    if len(found) < 2:
        return ((None,),)
    points = tuple(str(layer) for layer, kind in found if kind is not None and "Point" in kind)
    others = tuple(str(layer) for layer, kind in found if kind is not None and "Point" not in kind)
    return tuple(group for group in (points, others) if group) or ((None,),)


def _machines_apart(table: HarvestTable) -> HarvestTable:
    """With the names of their layers as machines, where layers without such were recorded at once."""
    if len(table.sources) < 2 or table.labels["machine"].names != ("",):
        return table
    of_source = [table["time_s"][table.source_of_row == number] for number in range(len(table.sources))]
    seconds = [np.unique(np.floor(times[np.isfinite(times)])) for times in of_source]
    at_once = any(
        len(np.intersect1d(one, other)) > _AT_ONCE * min(len(one), len(other)) > 0 for one, other in combinations(seconds, 2)
    )
    if not at_once:
        return table
    names = tuple(source.path.rpartition(": ")[2].removeprefix("layer ") for source in table.sources)
    return replace(table, labels={**table.labels, "machine": Label(table.source_of_row, names)})


def _read_layer(address: str, where: str, part: str | None) -> Layer:
    """A layer by name, or the only one. Raises InputError where there is none."""
    import pyogrio
    import pyogrio.errors
    import pyogrio.raw

    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            meta, _, geometry, fields = pyogrio.raw.read(address, layer=part or 0)
    except (
        pyogrio.errors.DataSourceError,
        pyogrio.errors.DataLayerError,
        pyogrio.errors.GeometryError,
        pyogrio.errors.FeatureError,
        pyogrio.errors.FieldError,
        ValueError,
        RuntimeError,
        NameError,  # raised within pyogrio where a projection file is damaged
        UnicodeError,
        OverflowError,
    ) as error:
        raise InputError(where, f"cannot be read: {brief(error)}", "a vector file that GDAL reads") from error
    kind = str(meta.get("geometry_type"))
    names = tuple(map(str, meta["fields"]))
    said_by_gdal = _warnings([str(one.message) for one in said])
    return layer_of(geometry, dict(zip(names, fields, strict=True)), meta.get("crs"), where, kind, said_by_gdal)


def layer_of(
    geometry: np.ndarray | None,
    fields: Mapping[str, np.ndarray],
    crs: str | None,
    where: str,
    kind: str = "no shapes",
    said: tuple[str, ...] = (),
) -> Layer:
    """A layer of well-known binary shapes. Raises InputError where there is none.

    Parameters
    ----------
    geometry : array of bytes, shape (n,), or None
        One a row.
    fields : mapping of str to array, shape (n,)
        By name.
    crs : str or None
        The coordinate system that the file names.
    where : str
        Place for errors.
    kind : str
        Of shape, as the file says.
    said : tuple of str
        While it was read.
    """
    if geometry is None or not len(geometry):
        raise InputError(where, "has no points", "a layer of points")
    x, y = _points(geometry)
    if not np.isfinite(x).any():
        raise InputError(where, f"holds {kind}", "points")
    return Layer(tuple(fields), tuple(fields.values()), x, y, crs, said)


def _layer(path: Path, address: str, name: str, part: str | None, options: ReadOptions) -> HarvestTable:
    where = (f"{path}: {name}" if name != path.name else str(path)) + (f": layer {part}" if part else "")
    sidecar = _metadata(path, name)
    kind = "John Deere Operations Center" if sidecar.units else KIND
    return table_of(_read_layer(address, where, part), sidecar, where, kind, options)


def table_of(layer: Layer, sidecar: Metadata, where: str, kind: str, options: ReadOptions) -> HarvestTable:
    """The harvest in a layer. Raises InputError where it is none.

    Parameters
    ----------
    layer : Layer
    sidecar : Metadata
        What a file beside it says.
    where : str
        Place for errors.
    kind : str
        Of source.
    options : ReadOptions
    """
    x, y, notes = to_degrees(layer.x, layer.y, layer.crs, options, where)
    usable = [one for one in layer.names if one not in _POSITION]
    wanted = {quantity: column for quantity, column in options.columns.items() if quantity not in _POSITION}
    fields = dict(zip(layer.names, layer.fields, strict=True))
    width_known = options.width_m is not None
    found, more = columns_of(usable, wanted, sidecar.units, where, width_known=width_known, numbers_of=first_numbers(fields))
    columns, numbers, texts, unreadable = values_of(found, fields)
    columns |= {"longitude": Column(" x", "longitude", "deg"), "latitude": Column(" y", "latitude", "deg")}
    numbers |= {" x": x, " y": y}
    for quantity, said in (("crop", sidecar.crop), ("field", sidecar.field)):
        if said:
            texts[f" {quantity}"] = Label.constant(said, len(x))
            columns[quantity] = Column(f" {quantity}", quantity, "")
    return assemble(Raw(columns, numbers, texts, len(x), notes=(*notes, *layer.said, *more, *unreadable)), where, kind, options)


def first_numbers(fields: Mapping[str, np.ndarray]) -> Callable[[str], Array]:
    """What gives the numbers in the first rows of a column, by its name. fields: as for values_of."""

    def numbers(name: str) -> Array:
        values = fields[name][:_LOOKED_AT]
        if values.dtype == object:
            return numbers_in(["" if one is None else str(one) for one in values])
        return values.astype(float) if np.issubdtype(values.dtype, np.number) else np.full(len(values), np.nan)

    return numbers


def values_of(
    columns_found: Mapping[str, Column], fields: Mapping[str, np.ndarray]
) -> tuple[dict[str, Column], dict[str, Array], dict[str, Label], tuple[str, ...]]:
    """Columns by quantity, numbers and texts by column, and notes on what is no number.

    Parameters
    ----------
    columns_found : mapping of str to Column
        By quantity.
    fields : mapping of str to array, shape (n,)
        By name of the column.
    """
    found = {quantity: (column, fields[column.name]) for quantity, column in columns_found.items()}
    columns = dict(columns_found)
    numbers: dict[str, Array] = {}
    texts: dict[str, Label] = {}
    for quantity, (column, values) in found.items():
        kind = QUANTITIES[quantity].kind
        if np.issubdtype(values.dtype, np.datetime64):
            numbers[column.name] = _unix(values)
            columns[quantity] = Column(column.name, quantity, "s")
        elif values.dtype != object and kind != "text":
            numbers[column.name] = values.astype(float)
        elif kind in ("text", "date", "state"):
            texts[column.name] = labels_from(list(values))
        else:
            label = labels_from(list(values))
            numbers[column.name] = numbers_in(label.names)[label.codes]
    moment = next((found[q][0] for q in found if q in ("time", "day") and _is_moment(found[q][1])), None)
    if moment is not None:
        numbers["unix time"] = numbers.pop(moment.name)
        columns["time"] = Column("unix time", "time", "s")
    return columns, numbers, texts, _unreadable(numbers, {column.name: values for column, values in found.values()})


def _warnings(said: Sequence[str]) -> tuple[str, ...]:
    """What GDAL said while it read, of many the first."""
    if not said:
        return ()
    return (f"GDAL: {brief(said[0])}" + (f", and {len(said) - 1} more of its warnings" if len(said) > 1 else ""),)


def _is_moment(values: np.ndarray) -> bool:
    """Whether it holds times, not only days."""
    if not np.issubdtype(values.dtype, np.datetime64):
        return False
    return bool((values[~np.isnat(values)] != values[~np.isnat(values)].astype("datetime64[D]")).any())


def _unix(values: np.ndarray) -> Array:
    out = values.astype("datetime64[ms]").astype(np.int64) * 1e-3
    return np.where(np.isnat(values), np.nan, out)


def _unreadable(numbers: Mapping[str, Array], fields: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Notes on columns of texts of which some are no numbers."""
    notes = []
    for name, values in fields.items():
        if name in numbers and values.dtype == object:
            texts = ["" if text is None else str(text).strip() for text in values]
            lost = [text for text, found in zip(texts, numbers[name].tolist(), strict=True) if text and found != found]  # noqa: PLR0124
            lost = [text for text in lost if text.lower() not in UNKNOWN]
            if lost:
                notes.append(f"{name} holds no number in {len(lost)} of {len(texts)} rows, such as {lost[0][:40]!r}")
    return tuple(notes)


def _points(geometry: np.ndarray) -> tuple[Array, Array]:
    """x and y of well-known binary points, of other shapes their middle; NaN for none."""
    import shapely

    shapes = shapely.from_wkb(geometry, on_invalid="ignore")
    flat = shapely.get_type_id(shapes) != 0
    if flat.any():
        shapes[flat] = shapely.centroid(shapes[flat])
    return shapely.get_x(shapes), shapely.get_y(shapes)


def _metadata(path: Path, member: str) -> Metadata:
    """Units from the JSON beside the shapefile, in the zip or in the folder."""
    stem = member.rsplit("/", 1)[-1].rsplit(".", 1)[0]
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                names = [n for n in archive.namelist() if n.lower().endswith("metadata.json")]
                chosen = [n for n in names if n.rsplit("/", 1)[-1].startswith(stem)] or (names if len(names) == 1 else [])
                text = archive.read(chosen[0]) if chosen else b""
        else:
            folder = path if path.is_dir() else path.parent
            beside = [c for c in sorted(folder.iterdir()) if c.name.startswith(stem) and c.name.lower().endswith("metadata.json")]
            text = bounded.read_whole(beside[0], "JSON", _LARGEST_METADATA_BYTES) if beside else b""
        document = json.loads(text) if text else {}
        units = {str(one["Name"]): str(one.get("Unit", "")) for one in document.get("DataAttributes", [])}
        return Metadata(units, str(document.get("CropToken", "")), str(document.get("FieldName", "")))
    except (*ZIP_DAMAGE, ValueError, KeyError, TypeError, AttributeError):
        return Metadata({})
