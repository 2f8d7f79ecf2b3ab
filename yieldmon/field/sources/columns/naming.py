"""Which column of a file is which quantity, and in which unit.

From a map that a person gives, from the file's own metadata, or from a name that says its unit, such as `Flow(lb/s)` or
`mass_flow_kg_s`. A known name without a unit is an error that asks for one.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from yieldmon.errors import InputError
from yieldmon.field.table import Array
from yieldmon.field.units import BUSHELS, FACTORS, factor, is_bushels, is_unit_of, plain_unit

from . import agreeing_units, rival_columns


@dataclass(frozen=True)
class Quantity:
    """kind: of units (see FACTORS), "date", "state" (on or off) or "text". names: how files call it, by plain_name."""

    kind: str
    names: tuple[str, ...]


def _names(text: str) -> tuple[str, ...]:
    return tuple(text.split())


#: Names without vowels, such as "dstnc", are what R makes of those of SMS in shapefiles.
QUANTITIES: Mapping[str, Quantity] = {
    "longitude": Quantity(
        "angle",
        _names(
            "longitude lon long lng x xcoord pointx longitud langengrad laengengrad longitudine lengtegraad lngdegrad lengdegrad "
            "dugoscgeograficzna easting ostwert rechtswert"
        ),
    ),
    "latitude": Quantity(
        "angle",
        _names(
            "latitude lat y ycoord pointy latitud breitengrad latitudine breedtegraad breddegrad szerokoscgeograficzna northing "
            "nordwert hochwert"
        ),
    ),
    "time": Quantity(
        "date",
        _names(
            "isotime timeutc utctime time timestamp datetime datetimeutc dateandtime gpstime gpstim unixtime datumuhrzeit "
            "datumzeit dateheure dateetheure fechahora fechayhora datahora dataehora uhrzeit zeit zeitstempel zeitpunkt hora "
            "heure dataora dataeora datumtijd datoogtid dataiczas ora tijd tijdstip tid tidspunkt czas utc gpsutc "
            "utctimestamp timestamputc localtime timelocal"
        ),
    ),
    "day": Quantity("text", _names("date gpsdate utcdate dateutc datum fecha data dato")),
    "flow": Quantity(
        "mass_flow",
        _names(
            "flowwet wetflow massflowwet wetmassflow flow massflow grainflow cropflow cropflowm cropflwm cropflw flowrate "
            "flw crpflwm crpflw massflowrate flowmass durchsatz durchfluss "
            "massenstrom flujo fluxo debit"
        ),
    ),
    "flow_sd": Quantity("mass_flow", _names("flowsd massflowsd stddev flowstddev")),
    "yield": Quantity(
        "mass_per_area",
        _names(
            # As weighed, then what does not say, then dried; in each a mass before a volume, which needs the crop's bushel.
            "yldmasswet yieldmasswet yldmssw wetmass wetyield yieldwet wetyieldmass wetmassyield ertragfeucht ertragnass "
            "rendimientohumedo rindehumedo hummasaderend masarendhum "
            "rendementhumide produtividadeumida yldvolwet yldvlw yieldvolwet wetyieldvol "
            "yield yld massyield yieldmass yldmass grainyield cropyield yieldvol ertrag kornertrag rendimiento rinde rendement "
            "produtividade rendimento produttivita resa plon opbrengst udbytte skord avling "
            "vryieldmas vryieldmass vryieldvol yldmassdry yldmssd yieldmassdry dryyield yielddry dryyieldmass drymassyield "
            "ertragtrocken "
            "rendimientoseco rindeseco secomasaderend masarendseco rendementsec produtividadeseca "
            "yldvoldry yldvld yieldvoldry dryyieldvol drymatter"
        ),
    ),
    "mass": Quantity("mass", ()),
    "moisture": Quantity(
        "percent",
        _names(
            "moisture moist mostr moistur grainmoisture harvestmoisture cropmoisture moisturecontent moisturepercent moisturewet "
            "wetmoisture humidity feuchte feuchtigkeit kornfeuchte erntefeuchte "
            "humedad humidite umidade umidita wilgotnosc vocht vochtgehalte vandindhold fugt vattenhalt vanninnhold fuktighet"
        ),
    ),
    "interval": Quantity("time", _names("interval interv duration durtn loginterval cycles cycle logint dt")),
    "distance": Quantity(
        "length",
        _names(
            "distance dist dstnc dstncf distancetravelled distancetraveled distanz strecke distancia distanza afstand avstand"
        ),
    ),
    "speed": Quantity(
        "speed",
        _names(
            "speed vehiclespeed groundspeed vehiclspeed geschwindigkeit velocidad velocidade vitesse velocita snelheid hastighed "
            "hastighet predkosc"
        ),
    ),
    "width": Quantity(
        "length",
        _names(
            "width swath swathwidth swthwdth swthw swthwidth workingwidth headerwidth swthwdthm cuttingwidth arbeitsbreite "
            "schnittbreite breite anchodetrabajo anchodecorte anchdefja anchfja ancho "
            "largeurdetravail largeurdecoupe largeur larguradetrabalho "
            "larguradecorte largura larghezza larghezzadilavoro larghezzaditaglio werkbreedte maaibreedte arbejdsbredde "
            "arbetsbredd arbeidsbredde szerokoscrobocza"
        ),
    ),
    "heading": Quantity("angle", _names("heading head hdng course track trackdeg trckd bearing kurs rumbo")),
    "elevation": Quantity("length", _names("elevation altitude elev elevtn height z hohe hoehe altitud")),
    "position_sd": Quantity("length", _names("positionsd")),
    "header": Quantity(
        "state",
        _names(
            "headerdown header headerstatus headerstate headerposition harvesting inwork workstate workingstate recordingstatus "
            "areacount arecnt arbeitsstellung arbeitszustand"
        ),
    ),
    "pass": Quantity("none", _names("pass passnumber passnum passnm")),
    "section": Quantity("none", _names("section sectionid sectionnumber sectionno boomsection teilbreite seccion secao")),
    "field": Quantity("text", _names("field fieldname schlag lote parcelle")),
    "load": Quantity("text", _names("load loadname loadnumber ladung fuhre carga")),
    "crop": Quantity("text", _names("crop grain cropname frucht kultur cultivo cultura culture coltura gewas groda uprawa")),
    "machine": Quantity(
        "text",
        _names(
            "machine serial serialnumber machineid machinename machineserial combine combineserial vehicle vehicleid vehiclename "
            "equipment maschine mahdrescher maquina cosechadora colheitadeira moissonneuse machineserie"
        ),
    ),
    "number": Quantity("none", _names("objid objectid recordid pointid rowid recno seq sequence id gid fid")),
    "dataset": Quantity("text", _names("dataset datasetname")),
    "product": Quantity("text", _names("product variety hybrid")),
}
_KNOWN_NAMES = frozenset(name for facts in QUANTITIES.values() for name in facts.names)
_NEEDS_NO_UNIT = ("longitude", "latitude", "time", "moisture", "heading")
_SHAPEFILE_NAME, _LEAST_CUT = 10, 7
"""Longest name of a column in a shapefile, and shortest in plain letters that still says what was cut."""
_DRIED = re.compile(r"dry|trocken|sec[oa]?$|^seco|^vryield")
_BRACKETS = re.compile(r"[(\[]([^()\[\]]*)[)\]]\s*$")
_BEHIND_A_BLANK = (re.compile(r"[\s,]+(\S+\s+\S+(?:-1|⁻¹))$"), re.compile(r"[\s,]+(\S*/\S+|mph|ft|cm|%|m)$"))
"""Units without brackets: two words of which the second is a reciprocal, or one that cannot be a part of the name."""
_UNIT_WORDS = [
    *sorted(
        {
            unit.replace("/", "_"): unit
            for kind in FACTORS.values()
            for unit in kind
            if unit and unit.isascii() and "%" not in unit
        }.items(),
        key=lambda item: -len(item[0]),
    ),
    ("bu_ac", "bu/ac"),
    ("km_h", "km/h"),
]


@dataclass(frozen=True)
class Column:
    """A file's column: its name there, the quantity, its unit ("" where none is needed)."""

    name: str
    quantity: str
    unit: str


def split_unit(name: str) -> tuple[str, str]:
    """A name without its unit, and the unit.

    >>> split_unit("Flow(lb/s)"), split_unit("mass_flow_kg_s"), split_unit("Yld Mass(Wet)(lb/ac)"), split_unit("Yield t ha-1")
    (('Flow', 'lb/s'), ('mass_flow', 'kg/s'), ('Yld Mass(Wet)', 'lb/ac'), ('Yield', 't/ha'))
    >>> split_unit("Speed_mph_")
    ('Speed', 'mph')
    """
    found = _BRACKETS.search(name)
    if found and _is_unit(plain_unit(found[1])):
        return name[: found.start()].strip(), plain_unit(found[1])
    closed = name.rstrip("_")  # a bracket, in shapefiles and R
    lower = closed.lower()
    for word, unit in _UNIT_WORDS:
        if lower.endswith("_" + word):
            megagram = closed[-len(word) :].startswith("Mg")
            return closed[: -len(word) - 1], f"t{unit.removeprefix('mg')}" if megagram else unit
    for pattern in _BEHIND_A_BLANK:
        behind = pattern.search(name)
        if behind and _is_unit(plain_unit(behind[1])):
            return name[: behind.start()].strip(), plain_unit(behind[1])
    return name, ""


def _is_unit(plain: str) -> bool:
    return any(plain in kind for kind in (*FACTORS.values(), BUSHELS))


def _require_unit_of(quantity: str, unit: str) -> None:
    """Raises InputError for a unit that a person gives and that would count for nothing."""
    kind = QUANTITIES[quantity].kind
    if unit and kind == "date":
        factor(unit, "time", "--column time")
    elif unit and (kind not in FACTORS or kind == "none"):
        raise InputError(f"--column {quantity}", f"has the unit {unit!r}", f"{quantity}=NAME, which has none")


@lru_cache(maxsize=1024)
def _spellings(name: str, bare: str) -> tuple[str, ...]:
    """What a column may be called: with and without its unit, and without brackets that hold no known one."""
    return plain_name(bare), plain_name(name), plain_name(_BRACKETS.sub("", name))


def _is_called(wanted: str, name: str, bare: str) -> bool:
    """Whether a column bears a known name, whole or cut to ten characters as in a shapefile, its unit with it."""
    spelled = _spellings(name, bare)
    if wanted in spelled:
        return True
    plain = spelled[1]
    return len(name) == _SHAPEFILE_NAME and len(plain) >= _LEAST_CUT and (wanted.startswith(plain) or wanted == plain[:-1])


def is_known_name(name: str) -> bool:
    """Whether a column of this name would be taken as a quantity."""
    bare, _ = split_unit(name)
    return not _KNOWN_NAMES.isdisjoint(_spellings(name, bare))


def plain_name(name: str) -> str:
    """Small letters and digits only; letters without their accents."""
    return re.sub(r"[^a-z0-9]", "", unicodedata.normalize("NFKD", name.lower()))


def columns_of(
    names: Sequence[str],
    given: Mapping[str, tuple[str, str]],
    units: Mapping[str, str],
    where: str,
    *,
    width_known: bool = False,
    numbers_of: Callable[[str], Array] | None = None,
) -> tuple[dict[str, Column], tuple[str, ...]]:
    """Quantity -> column, and notes.

    Parameters
    ----------
    names : sequence of str
        Of the file.
    given : mapping of str to (str, str)
        A person's map: quantity -> name and unit.
    units : mapping of str to str
        The file's own metadata: name -> unit.
    where : str
        Place for errors.
    width_known : bool
        Whether the file's own width is not needed.
    numbers_of : callable, optional
        A column's numbers in some of its rows, by its name: units that no name says are looked for in them.

    Raises
    ------
    InputError
        For a quantity or name that does not exist, or a column without a unit.
    """
    out = _given_columns(names, given, units, where)
    notes = []
    lacking: dict[str, str] = {}
    found = [(name, *split_unit(name)) for name in names]
    place = {} if {"longitude", "latitude"} & out.keys() else _place_in_german(found)
    out |= place
    found = [row for row in found if all(row[0] != column.name for column in place.values())]
    for quantity in QUANTITIES:
        if quantity not in out:
            column = _named_column(quantity, found, units, lacking)
            if column is not None and quantity == "moisture" and not column.unit:
                column = replace(column, unit="%")
                notes.append(f"{column.name} is taken as %")
            if column is not None:
                out[quantity] = column
    if numbers_of is not None and lacking:
        by_numbers = _units_by_numbers(out, lacking, numbers_of)
        out |= by_numbers
        if by_numbers:
            said = ", ".join(f"{column.name} {column.unit}" for column in by_numbers.values())
            notes.append(f"units that no column name states: {said}, chosen so that flow and yield give the same mass")
    if numbers_of is not None:
        notes += _contradicting(out, given, found, units, numbers_of)
    if "flow" not in out and "yield" in out and _DRIED.search(plain_name(out["yield"].name)):
        may_be = "may be" if plain_name(out["yield"].name).startswith("vr") else "is"
        notes.append(f"{out['yield'].name} {may_be} of dried grain: so are the masses")
    _check_useful(out, lacking, names, where, width_known=width_known)
    notes += [f"{name} has no unit and is not used" for name in lacking if name not in {column.name for column in out.values()}]
    return out, tuple(notes)


def _contradicting(
    out: Mapping[str, Column],
    given: Mapping[str, tuple[str, str]],
    found: Sequence[tuple[str, str, str]],
    units: Mapping[str, str],
    numbers_of: Callable[[str], Array],
) -> tuple[str, ...]:
    """Notes on other columns of the quantity that the masses come from, where nobody has chosen one."""
    quantity = next((q for q in ("mass", "flow", "yield") if q in out), "")
    if quantity not in ("flow", "yield") or quantity in given:
        return ()
    facts, used = QUANTITIES[quantity], out[quantity]
    if is_bushels(used.unit, facts.kind):
        return ()
    others = []
    for name, bare, own in found:
        unit = units.get(name, "") or own
        called = any(_is_called(wanted, name, bare) for wanted in facts.names)
        if name != used.name and called and unit and is_unit_of(unit, facts.kind) and not is_bushels(unit, facts.kind):
            dried = bool(_DRIED.search(plain_name(name))) != bool(_DRIED.search(plain_name(used.name)))
            others.append((name, factor(unit, facts.kind, name), dried))
    return rival_columns.contradiction(quantity, (used.name, factor(used.unit, facts.kind, used.name)), others, numbers_of)


def _given_columns(
    names: Sequence[str], given: Mapping[str, tuple[str, str]], units: Mapping[str, str], where: str
) -> dict[str, Column]:
    """Those of a person's map."""
    out: dict[str, Column] = {}
    for quantity, (name, unit) in given.items():
        if quantity not in QUANTITIES:
            raise InputError("--column", f"names the quantity {quantity!r}", f"one of {', '.join(QUANTITIES)}")
        if name not in names:
            raise InputError(where, f"has no column {name!r}", f"one of {', '.join(names[:30])}")
        _require_unit_of(quantity, unit)
        out[quantity] = Column(name, quantity, unit or units.get(name, "") or split_unit(name)[1])
    return out


def _place_in_german(found: Sequence[tuple[str, str, str]]) -> dict[str, Column]:
    """Columns "Länge" and "Breite" where a table has both and no other place; "Breite" alone is a width."""
    plain = {plain_name(bare): (name, unit) for name, bare, unit in found if not unit or is_unit_of(unit, "angle")}
    names = (("longitude", ("lange", "laenge")), ("latitude", ("breite",)))
    out = {q: Column(plain[n][0], q, plain[n][1]) for q, spellings in names for n in spellings if n in plain}
    others = any(_is_called(wanted, name, bare) for q in out for wanted in QUANTITIES[q].names for name, bare, _ in found)
    return out if len(out) == len(names) and not others else {}


def _named_column(
    quantity: str, found: Sequence[tuple[str, str, str]], units: Mapping[str, str], lacking: dict[str, str]
) -> Column | None:
    """The first column that is called as a quantity, None where none is; one without a unit that it needs joins `lacking`.

    found: each column's name, the name without its unit, and the unit.
    """
    facts = QUANTITIES[quantity]
    # What has a unit is no text: load_kg is a mass, not a load's name.
    fits = [row for row in found if not (facts.kind == "text" and row[2])]
    for wanted in facts.names:
        named = next(((name, unit) for name, bare, unit in fits if _is_called(wanted, name, bare)), None)
        if named is None:
            continue
        unit = units.get(named[0], "") or (named[1] if is_unit_of(named[1], facts.kind) else "")
        if unit or facts.kind in ("text", "date", "state", "none") or quantity in _NEEDS_NO_UNIT:
            return Column(named[0], quantity, unit)
        lacking.setdefault(named[0], quantity)
    return None


def _units_by_numbers(
    out: Mapping[str, Column], lacking: Mapping[str, str], numbers_of: Callable[[str], Array]
) -> dict[str, Column]:
    """Columns of those that lack a unit whose numbers tell it; none where they do not."""
    first = {quantity: name for name, quantity in reversed(list(lacking.items()))}
    names = first | {quantity: column.name for quantity, column in out.items()}
    if not set(agreeing_units.QUANTITIES) <= names.keys() or any(q in out and not out[q].unit for q in agreeing_units.QUANTITIES):
        return {}
    known = {quantity: out[quantity].unit for quantity in agreeing_units.QUANTITIES if quantity in out}
    numbers = {quantity: numbers_of(names[quantity]) for quantity in agreeing_units.QUANTITIES}
    units = agreeing_units.agreeing_units(numbers, known)
    return {quantity: Column(names[quantity], quantity, unit) for quantity, unit in units.items()}


def _check_useful(
    out: Mapping[str, Column], lacking: Mapping[str, str], names: Sequence[str], where: str, *, width_known: bool
) -> None:
    """Raises InputError where there is no flow, or a width of no known unit."""
    width_lacks = not width_known and "width" not in out and "width" in lacking.values()
    if not width_lacks and ("flow" in out or "yield" in out or "mass" in out):
        return
    if lacking:
        first, quantity = next(item for item in lacking.items() if not width_lacks or item[1] == "width")
        raise InputError(where, f"states no known unit for {', '.join(lacking)}", f"--column {quantity}={first}:UNIT and so on")
    among = f"among {', '.join(names[:20])}" if names else "and no other"
    raise InputError(
        where, f"has no column of flow or yield {among}", "--column flow=NAME:UNIT, yield=NAME:UNIT or mass=NAME:UNIT"
    )
