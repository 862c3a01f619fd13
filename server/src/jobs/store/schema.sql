-- Version 1.
CREATE TABLE jobs (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    id TEXT NOT NULL UNIQUE,
    owner TEXT NOT NULL,
    -- Of the request: its Idempotency-Key, and its SHA-256.
    key TEXT,
    digest BLOB NOT NULL,
    volume TEXT NOT NULL,
    -- JSON of the files that it reads.
    input TEXT NOT NULL,
    state TEXT NOT NULL,
    -- Seconds since 1970.
    submitted REAL NOT NULL,
    started REAL,
    finished REAL,
    -- Numbers of extractions.
    total INTEGER NOT NULL,
    done INTEGER NOT NULL DEFAULT 0,
    failed INTEGER NOT NULL DEFAULT 0,
    -- Sums over those that are done.
    bytes INTEGER NOT NULL DEFAULT 0,
    seconds REAL NOT NULL DEFAULT 0,
    estimated_triangles INTEGER NOT NULL,
    estimated_bytes INTEGER NOT NULL,
    estimated_seconds REAL NOT NULL,
    error_code TEXT,
    error_detail TEXT,
    UNIQUE (owner, key)
) STRICT;
CREATE INDEX unfinished_jobs ON jobs (number) WHERE state IN ('queued', 'running');

CREATE TABLE extractions (
    job INTEGER NOT NULL REFERENCES jobs (number) ON DELETE CASCADE,
    -- From 0.
    extraction INTEGER NOT NULL,
    -- JSON.
    request TEXT NOT NULL,
    -- waiting, done or failed.
    state TEXT NOT NULL DEFAULT 'waiting',
    -- Counted before they start.
    attempts INTEGER NOT NULL DEFAULT 0,
    bytes INTEGER,
    checksum BLOB,
    triangles INTEGER,
    seconds REAL,
    error_code TEXT,
    error_detail TEXT,
    PRIMARY KEY (job, extraction)
) STRICT, WITHOUT ROWID;
CREATE INDEX waiting_extractions ON extractions (job, extraction) WHERE state = 'waiting';

CREATE TABLE events (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    job INTEGER NOT NULL REFERENCES jobs (number) ON DELETE CASCADE,
    -- JSON.
    event TEXT NOT NULL
) STRICT;
CREATE INDEX events_of_jobs ON events (job, id);
