-- Sessions with their views and pictures, and the calibrations they led to. Documents are JSON in the contract's schema.
CREATE TABLE sessions (
    id TEXT PRIMARY KEY,
    camera TEXT NOT NULL,
    state TEXT NOT NULL,
    started_at_ns INTEGER NOT NULL,
    collecting_s REAL NOT NULL,
    document TEXT NOT NULL
) STRICT;

CREATE INDEX sessions_by_time ON sessions (started_at_ns);

CREATE TABLE views (
    session TEXT NOT NULL REFERENCES sessions (id),
    number INTEGER NOT NULL,
    sequence INTEGER NOT NULL,
    name TEXT,
    host_time_ns INTEGER NOT NULL,
    device_time_ns INTEGER,
    width INTEGER NOT NULL,
    height INTEGER NOT NULL,
    detection TEXT NOT NULL,
    media_type TEXT NOT NULL,
    picture BLOB NOT NULL,
    PRIMARY KEY (session, number)
) STRICT;

CREATE TABLE calibrations (
    id TEXT PRIMARY KEY,
    camera TEXT,
    session TEXT,
    created_at_ns INTEGER NOT NULL,
    document TEXT NOT NULL
) STRICT;

CREATE INDEX calibrations_by_camera ON calibrations (camera, created_at_ns);
