-- A store of schema version 1, as `.dump` gives it.
PRAGMA application_id = 2037215086;
PRAGMA user_version = 1;
BEGIN TRANSACTION;
CREATE TABLE counter (
    name TEXT PRIMARY KEY,
    value INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
INSERT INTO "counter" VALUES('samples_lost',4);
CREATE TABLE fault (               -- a row each time a fault comes or goes
    id INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,
    code TEXT NOT NULL,
    active INTEGER NOT NULL CHECK (active IN (0, 1)),
    detail TEXT NOT NULL
) STRICT;
INSERT INTO "fault" VALUES(1,1700000002.0,'FRAMES_LOST',1,'4 samples');
CREATE TABLE load (
    number INTEGER PRIMARY KEY,
    field TEXT NOT NULL,
    crop TEXT NOT NULL,
    started_s REAL,
    ended_s REAL,
    mass_kg REAL NOT NULL
) STRICT;
INSERT INTO "load" VALUES(1,'north','corn',1700000000.0,1700000002.0,9.5);
INSERT INTO "load" VALUES(2,'north','corn',1700000002.0,NULL,10.25);
CREATE TABLE parameter_set (
    version INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,
    origin TEXT NOT NULL,          -- file, sweep, ticket
    document TEXT NOT NULL         -- JSON: values, covariance, provenance
) STRICT;
INSERT INTO "parameter_set" VALUES(1,1700000000.0,'file','{"friction":0.3}');
CREATE TABLE second (              -- one row for each second's window
    number INTEGER PRIMARY KEY,    -- counts up without a gap over the store's life
    time_s REAL NOT NULL,          -- end of the window
    load_number INTEGER NOT NULL,
    mass_kg REAL NOT NULL,         -- added to the totals by this second
    load_mass_kg REAL NOT NULL,    -- the totals after it
    total_mass_kg REAL NOT NULL,
    mass_flow_kg_s REAL,
    mass_flow_sd_kg_s REAL,
    quality INTEGER NOT NULL,      -- EstimateQuality
    operating_state INTEGER NOT NULL,
    elevator_speed_rpm REAL,
    plate_angle_deg REAL,
    force_n REAL,
    moisture_pct REAL,
    samples_lost INTEGER NOT NULL,
    parameter_version INTEGER NOT NULL
) STRICT;
INSERT INTO "second" VALUES(1,1700000001.0,1,9.5,9.5,9.5,9.5,0.12,0,3,400.0,70.0,8.25,15.5,0,1);
INSERT INTO "second" VALUES(2,1700000002.0,1,0.0,9.5,9.5,NULL,NULL,1,2,398.5,70.0,0.0,NULL,4,1);
INSERT INTO "second" VALUES(3,1700000003.0,2,10.25,10.25,19.75,10.25,0.15,0,3,401.0,70.0,8.75,15.5,0,1);
CREATE TABLE state (               -- what the monitor needs to go on after a restart
    id INTEGER PRIMARY KEY CHECK (id = 1),
    batch INTEGER NOT NULL,        -- number of the last batch that was committed
    time_s REAL NOT NULL,
    document TEXT NOT NULL         -- JSON: the monitor's snapshot
) STRICT;
INSERT INTO "state" VALUES(1,3,1700000003.0,'{"total_mass_kg":19.75}');
CREATE TABLE sweep (
    id INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,
    outcome TEXT NOT NULL,
    reason TEXT NOT NULL,
    document TEXT NOT NULL         -- JSON: angles, forces, posterior
) STRICT;
INSERT INTO "sweep" VALUES(1,1700000002.5,'ABORTED','flow changed','{"angles_deg":[70,60]}');
COMMIT;
