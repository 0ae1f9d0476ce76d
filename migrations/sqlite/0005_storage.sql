-- Hosts are stored once per geometry: hosts/{host_geometry} in the blob store, whichever file it came
-- in. The key is a hash of positions and triangles in order (blobs/geometry.rs). Null in records of
-- before; the service fills it in at its next start, where the host is kept.
ALTER TABLE watermarks ADD COLUMN host_geometry BLOB CHECK (length(host_geometry) = 32);
CREATE INDEX watermarks_by_geometry ON watermarks (host_geometry) WHERE host_geometry IS NOT NULL;

-- What the short list of a verification is found by, per geometry. (Takes the place of the table
-- hosts, which was keyed by the hash of a file and is written no more.)
CREATE TABLE geometries (
    geometry  BLOB PRIMARY KEY NOT NULL CHECK (length(geometry) = 32),
    sketch    BLOB NOT NULL
) STRICT;

-- Which registry this is, and how often it was written to: noted in the data directory, so that
-- another registry or an older backup is noticed that is put in its place. Changes never go down.
CREATE TABLE identity (
    one      INTEGER PRIMARY KEY CHECK (one = 1),
    id       TEXT NOT NULL,
    changes  INTEGER NOT NULL
) STRICT;
INSERT INTO identity SELECT 1, lower(hex(randomblob(16))), count(*) FROM watermarks;
CREATE TRIGGER changes_registered AFTER INSERT ON watermarks BEGIN
    UPDATE identity SET changes = changes + 1;
END;
CREATE TRIGGER changes_revoked AFTER UPDATE OF revoked_at ON watermarks BEGIN
    UPDATE identity SET changes = changes + 1;
END;
CREATE TRIGGER changes_verified AFTER INSERT ON verifications BEGIN
    UPDATE identity SET changes = changes + 1;
END;
