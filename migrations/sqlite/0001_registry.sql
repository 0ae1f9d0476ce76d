-- The registry of one data directory. Secrets are not here: a mark key needs the master key
-- file as well (key_id says which key of it), so a stolen copy of this file reads no mark.

-- One registered mark. A row exists if and only if its marked file could be handed out.
CREATE TABLE watermarks (
    id             TEXT PRIMARY KEY NOT NULL,  -- UUID version 7: in order of registration
    owner_id       TEXT NOT NULL,              -- whose mark it is
    recipient      TEXT,                       -- to whom this copy went
    label          TEXT,                       -- free text of the owner
    method         TEXT NOT NULL,              -- 'qsp-mean', ...
    scheme         INTEGER NOT NULL,           -- version of the watermark scheme
    strength       REAL NOT NULL,
    bits           INTEGER NOT NULL,           -- M, the length of the message
    key_id         TEXT NOT NULL,              -- which master key; never the key itself
    salt           BLOB NOT NULL CHECK (length(salt) = 32),
    message        BLOB NOT NULL,              -- the M bits, most significant bit first
    payload        BLOB,                       -- what the caller asked to embed, if anything
    centre_x       REAL NOT NULL,              -- the host's frame, for detection in place
    centre_y       REAL NOT NULL,
    centre_z       REAL NOT NULL,
    rho_min        REAL NOT NULL,
    rho_max        REAL NOT NULL,
    host_sha256    BLOB NOT NULL CHECK (length(host_sha256) = 32),
    marked_sha256  BLOB NOT NULL CHECK (length(marked_sha256) = 32),
    marked_bytes   INTEGER NOT NULL,
    format         TEXT NOT NULL,              -- 'obj', 'gltf', 'glb'
    file_name      TEXT,                       -- as uploaded, for the name of the marked file
    vertices       INTEGER NOT NULL,
    triangles      INTEGER NOT NULL,
    usable_bins    INTEGER NOT NULL,
    file_kept      INTEGER NOT NULL,           -- 1: files/{id} is in the blob store
    host_kept      INTEGER NOT NULL,           -- 1: hosts/{id} is in the blob store
    created_at     INTEGER NOT NULL,           -- microseconds since 1970, UTC
    revoked_at     INTEGER                     -- revoked marks are kept and not searched
) STRICT;

-- Pages of one owner, newest first. (Pages of all: the primary key.)
CREATE INDEX watermarks_by_owner ON watermarks (owner_id, id);

-- What an Idempotency-Key was used for, so that a retry gets the same record and bytes.
CREATE TABLE idempotency (
    owner_id      TEXT NOT NULL,
    key           TEXT NOT NULL,
    fingerprint   BLOB NOT NULL,               -- SHA-256 over the parameters and the file's hash
    watermark_id  TEXT NOT NULL REFERENCES watermarks (id),
    PRIMARY KEY (owner_id, key)
) STRICT, WITHOUT ROWID;

-- Verdicts, as they were answered.
CREATE TABLE verifications (
    id          TEXT PRIMARY KEY NOT NULL,     -- UUID version 7
    created_at  INTEGER NOT NULL,
    answer      TEXT NOT NULL                  -- JSON
) STRICT;
