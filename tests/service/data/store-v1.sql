-- A store of schema version 1, as `.dump` gives it.
PRAGMA application_id = 2037215086;
PRAGMA user_version = 1;
BEGIN TRANSACTION;
CREATE TABLE counter (
    name TEXT PRIMARY KEY,
    value INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
INSERT INTO "counter" VALUES('frames_lost',4);
CREATE TABLE fault (               -- a row each time a fault comes or goes
    id INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,
    code TEXT NOT NULL,
    active INTEGER NOT NULL CHECK (active IN (0, 1)),
    detail TEXT NOT NULL
) STRICT;
INSERT INTO "fault" VALUES(1,1700000002.0,'FramesLost',1,'4 frames');
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
CREATE TABLE second (              -- one row for each second's window; columns as in rows.SecondRow
    number INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,          -- end of the window
    duration_s REAL NOT NULL,
    mass_flow_kg_s REAL,
    std_dev_kg_s REAL,
    quality INTEGER NOT NULL,
    operating_state INTEGER NOT NULL,
    mass_kg REAL NOT NULL,         -- added to the totals by this second
    load_number INTEGER NOT NULL,
    load_kg REAL NOT NULL,         -- the totals after it
    total_kg REAL NOT NULL,
    coverage REAL NOT NULL,
    force_n REAL,
    force_std_dev_n REAL,
    elevator_speed_rpm REAL,
    plate_angle_deg REAL,
    plate_still INTEGER NOT NULL,
    moisture_pct REAL,
    test_weight_kg_m3 REAL,
    zero_mv REAL,
    pulse_mv REAL,
    saturated_share REAL,
    lost_frames INTEGER NOT NULL,
    surplus_frames INTEGER NOT NULL,
    repeated_frames INTEGER NOT NULL,
    sweep_id INTEGER NOT NULL,
    sweep_step INTEGER NOT NULL,
    usable_for_calibration INTEGER NOT NULL,
    parameter_version INTEGER NOT NULL,
    faults TEXT NOT NULL,
    latitude_deg REAL,
    longitude_deg REAL,
    ground_speed_m_s REAL,
    course_deg REAL
) STRICT;
INSERT INTO "second" VALUES(1,1700000001.0,1.0,9.5,0.12,0,3,9.5,1,9.5,9.5,1.0,8.25,0.1,400.0,70.0,1,15.5,NULL,120.5,31.0,0.0,0,0,0,0,-1,0,1,'',NULL,NULL,NULL,NULL);
INSERT INTO "second" VALUES(2,1700000002.0,1.0,NULL,NULL,1,2,0.0,1,9.5,9.5,1.0,8.25,0.1,400.0,70.0,1,NULL,NULL,120.5,31.0,0.0,4,0,0,0,-1,0,1,'FramesLost',NULL,NULL,NULL,NULL);
INSERT INTO "second" VALUES(3,1700000003.0,1.0,10.25,0.15,0,3,10.25,2,10.25,19.75,1.0,8.25,0.1,400.0,70.0,1,15.5,NULL,120.5,31.0,0.0,0,0,0,0,-1,0,1,'',NULL,NULL,NULL,NULL);
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
