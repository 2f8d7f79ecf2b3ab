"""The store's tables, as the chain of steps that made them.

Each entry of `MIGRATIONS` takes a store from the version before to its own, in one transaction. A new store walks the
whole chain, so it cannot differ from one that grew up. Never change an entry that was released: add one.

The columns of the table `second` are those of `engine.records`, each added with the version that its declaration names (`since`).

Conventions: `time_s` is Unix time in seconds as the bus gave it; NULL is "not available"; masses are wet unless
named dry.
"""

from __future__ import annotations

from yieldmon.engine.records import COLUMNS as SECOND_COLUMNS
from yieldmon.engine.records import Column

#: Marks the file as a yieldmon store in SQLite's header ("ymon").
APPLICATION_ID = 0x796D6F6E

_VERSION_1 = """
CREATE TABLE load (
    number INTEGER PRIMARY KEY,
    field TEXT NOT NULL,
    crop TEXT NOT NULL,
    started_s REAL,
    ended_s REAL,
    mass_kg REAL NOT NULL
) STRICT;
CREATE TABLE sweep (
    id INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,
    outcome TEXT NOT NULL,
    reason TEXT NOT NULL,
    document TEXT NOT NULL         -- JSON: angles, forces, posterior
) STRICT;
CREATE TABLE parameter_set (
    version INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,
    origin TEXT NOT NULL,          -- file, sweep, ticket, kernels
    document TEXT NOT NULL         -- JSON: values, covariance, provenance
) STRICT;
CREATE TABLE fault (               -- a row each time a fault comes or goes
    id INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,
    code TEXT NOT NULL,
    active INTEGER NOT NULL CHECK (active IN (0, 1)),
    detail TEXT NOT NULL
) STRICT;
CREATE TABLE counter (
    name TEXT PRIMARY KEY,
    value INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE TABLE state (               -- what the monitor needs to go on after a restart
    id INTEGER PRIMARY KEY CHECK (id = 1),
    batch INTEGER NOT NULL,        -- number of the last batch that was committed
    time_s REAL NOT NULL,
    document TEXT NOT NULL         -- JSON: the monitor's snapshot
) STRICT;
"""

_VERSION_2 = """
ALTER TABLE load ADD COLUMN dry_mass_kg REAL;      -- at market moisture; NULL where moisture was not known throughout
CREATE TABLE ticket (              -- a weighed mass for one or several loads; the loads' own rows stay as measured
    id INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,
    first_load INTEGER NOT NULL,
    last_load INTEGER NOT NULL CHECK (last_load >= first_load),
    weighed_mass_kg REAL NOT NULL CHECK (weighed_mass_kg > 0),
    measured_mass_kg REAL NOT NULL CHECK (measured_mass_kg > 0),
    note TEXT NOT NULL
) STRICT;
CREATE VIEW load_corrected AS      -- the newest ticket that covers a load is the one that counts
SELECT load.number, load.field, load.crop, load.started_s, load.ended_s, load.mass_kg, load.dry_mass_kg,
       load.mass_kg * COALESCE(ticket.weighed_mass_kg / ticket.measured_mass_kg, 1.0) AS corrected_mass_kg,
       load.dry_mass_kg * COALESCE(ticket.weighed_mass_kg / ticket.measured_mass_kg, 1.0) AS corrected_dry_mass_kg,
       ticket.id AS ticket_id
FROM load LEFT JOIN ticket ON ticket.id = (
    SELECT max(id) FROM ticket WHERE load.number BETWEEN ticket.first_load AND ticket.last_load);
"""

# A sweep's windows among millions of seconds.
_VERSION_3 = """
CREATE INDEX second_of_sweep ON second (number) WHERE usable_for_calibration = 1;
"""

# Each row carries a checksum (checksums.row_checksum), and the state is kept twice, turn about, so that a damaged page takes one
# second. Seconds may be millions: those from before stay as they are, and `mark` says up to which number.
_VERSION_4 = """
ALTER TABLE second ADD COLUMN checksum INTEGER NOT NULL DEFAULT -1;
ALTER TABLE load ADD COLUMN checksum INTEGER NOT NULL DEFAULT -1;
ALTER TABLE sweep ADD COLUMN checksum INTEGER NOT NULL DEFAULT -1;
ALTER TABLE parameter_set ADD COLUMN checksum INTEGER NOT NULL DEFAULT -1;
ALTER TABLE fault ADD COLUMN checksum INTEGER NOT NULL DEFAULT -1;
ALTER TABLE ticket ADD COLUMN checksum INTEGER NOT NULL DEFAULT -1;
ALTER TABLE counter ADD COLUMN checksum INTEGER NOT NULL DEFAULT -1;
UPDATE load SET checksum = row_checksum('load', number, field, crop, started_s, ended_s, mass_kg, dry_mass_kg);
UPDATE sweep SET checksum = row_checksum('sweep', time_s, outcome, reason, document);
UPDATE parameter_set SET checksum = row_checksum('parameter_set', version, time_s, origin, document);
UPDATE fault SET checksum = row_checksum('fault', time_s, code, active, detail);
UPDATE ticket SET checksum =
    row_checksum('ticket', time_s, first_load, last_load, weighed_mass_kg, measured_mass_kg, note);
UPDATE counter SET checksum = row_checksum('counter', name, value);
ALTER TABLE state RENAME TO state_before;
CREATE TABLE state (
    slot INTEGER PRIMARY KEY CHECK (slot IN (0, 1)),  -- batch modulo 2
    batch INTEGER NOT NULL,
    time_s REAL NOT NULL,
    document TEXT NOT NULL,
    checksum INTEGER NOT NULL
) STRICT;
INSERT INTO state SELECT batch % 2, batch, time_s, document, row_checksum('state', batch % 2, batch, time_s, document)
    FROM state_before;
DROP TABLE state_before;
CREATE TABLE mark (                -- what the store says of itself
    name TEXT PRIMARY KEY,         -- schema: its version; unchecked_seconds: number of the last second without a checksum
    value INTEGER NOT NULL,
    checksum INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
INSERT INTO mark SELECT 'unchecked_seconds', coalesce(max(number), 0),
    row_checksum('mark', 'unchecked_seconds', coalesce(max(number), 0)) FROM second;
"""

# Area harvested for a load; a load without a row has none that is known.
_VERSION_7 = """
CREATE TABLE load_area (
    number INTEGER PRIMARY KEY,
    area_m2 REAL NOT NULL,
    checksum INTEGER NOT NULL
) STRICT;
"""

# What was entered and updated, by whom and when, and the steps between updates.
_VERSION_8 = """
CREATE TABLE action (              -- what an operator told, what the monitor learnt, and what took either back
    number INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,
    kind TEXT NOT NULL,            -- ticket, ticket-undo, zero, zero-undo, parameters, posting, totals-reset
    who TEXT NOT NULL,             -- user of this computer; empty for the monitor itself
    document TEXT NOT NULL,        -- JSON
    checksum INTEGER NOT NULL
) STRICT;
CREATE TABLE step (                -- from one update to the next, as a smoother needs it
    version INTEGER PRIMARY KEY,   -- of the parameters that came of it
    time_s REAL NOT NULL,
    document TEXT NOT NULL,        -- JSON: states and covariances
    checksum INTEGER NOT NULL
) STRICT;
DROP VIEW load_corrected;
CREATE VIEW load_corrected AS      -- the newest ticket that stands counts, else the newest posting, else what was measured
SELECT *, mass_kg * factor AS corrected_mass_kg, dry_mass_kg * factor AS corrected_dry_mass_kg FROM (
    SELECT load.number, load.field, load.crop, load.started_s, load.ended_s, load.mass_kg, load.dry_mass_kg,
           COALESCE(ticket.weighed_mass_kg / ticket.measured_mass_kg, posting.factor, 1.0) AS factor, ticket.id AS ticket_id
    FROM load
    LEFT JOIN ticket ON ticket.id = (
        SELECT max(id) FROM ticket WHERE load.number BETWEEN ticket.first_load AND ticket.last_load AND id NOT IN (
            SELECT json_extract(document, '$.ticket') FROM action WHERE kind = 'ticket-undo'))
    LEFT JOIN (
        SELECT load_factor.key AS number, load_factor.value AS factor, max(action.number)
        FROM action, json_each(action.document, '$.factors') AS load_factor
        WHERE action.kind = 'posting' AND NOT EXISTS (
            SELECT 1 FROM json_each(action.document, '$.tickets') AS of_ticket, action AS undo
            WHERE undo.kind = 'ticket-undo' AND json_extract(undo.document, '$.ticket') = of_ticket.value)
        GROUP BY load_factor.key) AS posting ON posting.number = CAST(load.number AS TEXT));
"""

# A posting by parameters that were taken back falls with them.
_VERSION_12 = """
DROP VIEW load_corrected;
CREATE VIEW load_corrected AS      -- the newest ticket that stands counts, else the newest posting, else what was measured
SELECT *, mass_kg * factor AS corrected_mass_kg, dry_mass_kg * factor AS corrected_dry_mass_kg FROM (
    SELECT load.number, load.field, load.crop, load.started_s, load.ended_s, load.mass_kg, load.dry_mass_kg,
           COALESCE(ticket.weighed_mass_kg / ticket.measured_mass_kg, posting.factor, 1.0) AS factor, ticket.id AS ticket_id
    FROM load
    LEFT JOIN ticket ON ticket.id = (
        SELECT max(id) FROM ticket WHERE load.number BETWEEN ticket.first_load AND ticket.last_load AND id NOT IN (
            SELECT json_extract(document, '$.ticket') FROM action WHERE kind = 'ticket-undo'))
    LEFT JOIN (
        SELECT load_factor.key AS number, load_factor.value AS factor, max(action.number)
        FROM action, json_each(action.document, '$.factors') AS load_factor
        WHERE action.kind = 'posting' AND NOT EXISTS (
            SELECT 1 FROM json_each(action.document, '$.tickets') AS of_ticket, action AS undo
            WHERE undo.kind = 'ticket-undo' AND json_extract(undo.document, '$.ticket') = of_ticket.value)
        AND NOT EXISTS (
            SELECT 1 FROM action AS undo LEFT JOIN json_each(undo.document, '$.versions') AS undone
            WHERE undo.kind = 'parameters-undo'
            AND json_extract(action.document, '$.version') IN (json_extract(undo.document, '$.version'), undone.value))
        GROUP BY load_factor.key) AS posting ON posting.number = CAST(load.number AS TEXT));
"""

# Standard deviation of a load's measured mass as it is known now; a load without a row has that of its last second alone.
_VERSION_13 = """
CREATE TABLE load_std_dev (
    number INTEGER PRIMARY KEY,
    std_dev_kg REAL NOT NULL,
    checksum INTEGER NOT NULL
) STRICT;
"""

# The same by cause, as the last word on the load has it; a load without a row is known by its seconds alone.
_VERSION_14 = """
CREATE TABLE load_budget (
    number INTEGER PRIMARY KEY,
    noise_kg2 REAL NOT NULL,       -- variance of what averages out
    parameters_kg REAL NOT NULL,   -- standard deviations of what the seconds share
    zero_kg REAL NOT NULL,
    moisture_kg REAL NOT NULL,
    motion_kg REAL NOT NULL,       -- of a moving plate, with its sign
    checksum INTEGER NOT NULL
) STRICT;
"""

# A ticket of which a load has a newer one counts no more; one for several loads is shared out by what they are known to hold.
_VERSION_15 = """
DROP VIEW load_corrected;
CREATE VIEW load_corrected AS      -- the ticket that counts, else the newest posting, else what was measured
WITH standing AS (
    SELECT * FROM ticket WHERE id NOT IN (SELECT json_extract(document, '$.ticket') FROM action WHERE kind = 'ticket-undo')),
counting AS (
    SELECT * FROM standing WHERE NOT EXISTS (
        SELECT 1 FROM standing AS newer
        WHERE newer.id > standing.id AND newer.first_load <= standing.last_load AND newer.last_load >= standing.first_load)),
posting AS (
    SELECT CAST(load_factor.key AS INTEGER) AS number, load_factor.value AS factor, max(action.number)
    FROM action, json_each(action.document, '$.factors') AS load_factor
    WHERE action.kind = 'posting' AND NOT EXISTS (
        SELECT 1 FROM json_each(action.document, '$.tickets') AS of_ticket, action AS undo
        WHERE undo.kind = 'ticket-undo' AND json_extract(undo.document, '$.ticket') = of_ticket.value)
    AND NOT EXISTS (
        SELECT 1 FROM action AS undo LEFT JOIN json_each(undo.document, '$.versions') AS undone
        WHERE undo.kind = 'parameters-undo'
        AND json_extract(action.document, '$.version') IN (json_extract(undo.document, '$.version'), undone.value))
    GROUP BY load_factor.key),
known AS (
    SELECT load.*, COALESCE(posting.factor, 1.0) AS again, counting.id AS ticket_id, counting.weighed_mass_kg,
           counting.measured_mass_kg
    FROM load
    LEFT JOIN counting ON load.number BETWEEN counting.first_load AND counting.last_load
    LEFT JOIN posting ON posting.number = load.number),
scaled AS (
    SELECT *, again * CASE WHEN ticket_id IS NULL THEN 1.0 ELSE COALESCE(weighed_mass_kg / NULLIF(
        SUM(mass_kg * again) OVER of_ticket + max(measured_mass_kg - SUM(mass_kg) OVER of_ticket, 0.0), 0.0),
        weighed_mass_kg / measured_mass_kg) END AS factor
    FROM known WINDOW of_ticket AS (PARTITION BY ticket_id))
SELECT number, field, crop, started_s, ended_s, mass_kg, dry_mass_kg, factor, ticket_id, mass_kg * factor AS corrected_mass_kg,
       dry_mass_kg * factor AS corrected_dry_mass_kg FROM scaled ORDER BY number;
"""

#: From this version on rows carry checksums.
CHECKED_FROM = 4

#: From this version on there are actions and steps.
ACTIONS_FROM = 8

_SCRIPTS = (
    _VERSION_1,
    _VERSION_2,
    _VERSION_3,
    _VERSION_4,
    "",
    "",
    _VERSION_7,
    _VERSION_8,
    "",
    "",
    "",
    _VERSION_12,
    _VERSION_13,
    _VERSION_14,
    _VERSION_15,
    "",  # the monitor's state holds how a run ended, which an older version would take for damage
    "",  # the same of the mass since the plate was last seen empty
)
_SQL_KINDS = {float: "REAL", int: "INTEGER", str: "TEXT"}
_WITHOUT = {float: "0.0", int: "0", str: "''"}


def _declared(column: Column) -> str:
    return f"{column.name} {_SQL_KINDS[column.kind]}{'' if column.optional else ' NOT NULL'}"


def _columns_of(version: int) -> str:
    """The statements that bring the columns of a second that came with a version."""
    columns = [column for column in SECOND_COLUMNS if column.since == version]
    if version == 1:
        listed = ",\n    ".join(["number INTEGER PRIMARY KEY", *map(_declared, columns)])
        return f"CREATE TABLE second (\n    {listed}\n) STRICT;\n"
    return "".join(
        f"ALTER TABLE second ADD COLUMN {_declared(column)}{'' if column.optional else f' DEFAULT {_WITHOUT[column.kind]}'};\n"
        for column in columns
    )


VERSION = max(len(_SCRIPTS), *(column.since for column in SECOND_COLUMNS))
MIGRATIONS: tuple[str, ...] = tuple(
    _columns_of(version) + (_SCRIPTS[version - 1] if version <= len(_SCRIPTS) else "") for version in range(1, VERSION + 1)
)


def second_columns(version: int) -> str:
    """What to select for a second's columns from a store of this version: those that it does not have have their defaults."""
    of_each = (
        column.name if column.since <= version else f"{'NULL' if column.optional else _WITHOUT[column.kind]} AS {column.name}"
        for column in SECOND_COLUMNS
    )
    return ", ".join(("number", *of_each))


#: Places in a second's row, its number first, that the checksum covers: in rows written now, then in those of older versions.
SECOND_CHECKED: tuple[tuple[int, ...], ...] = tuple(
    (0, *(place for place, column in enumerate(SECOND_COLUMNS, 1) if column.since <= version))
    for version in sorted({max(c.since, CHECKED_FROM) for c in SECOND_COLUMNS}, reverse=True)
)

#: Columns of each table whose rows carry a checksum, in the order in which it is taken, and the key that orders them.
COLUMNS: dict[str, tuple[str, ...]] = {
    "state": ("slot", "batch", "time_s", "document"),
    "mark": ("name", "value"),
    "parameter_set": ("version", "time_s", "origin", "document"),
    "load": ("number", "field", "crop", "started_s", "ended_s", "mass_kg", "dry_mass_kg"),
    "load_area": ("number", "area_m2"),
    "load_std_dev": ("number", "std_dev_kg"),
    "load_budget": ("number", "noise_kg2", "parameters_kg", "zero_kg", "moisture_kg", "motion_kg"),
    "ticket": ("time_s", "first_load", "last_load", "weighed_mass_kg", "measured_mass_kg", "note"),
    "counter": ("name", "value"),
    "sweep": ("time_s", "outcome", "reason", "document"),
    "fault": ("time_s", "code", "active", "detail"),
    "action": ("number", "time_s", "kind", "who", "document"),
    "step": ("version", "time_s", "document"),
}
KEYS: dict[str, str] = {
    "state": "slot", "mark": "name", "parameter_set": "version", "load": "number", "load_area": "number",
    "load_std_dev": "number", "load_budget": "number", "ticket": "id",
    "counter": "name", "sweep": "id", "fault": "id", "second": "number", "action": "number", "step": "version",
}  # fmt: skip
