-- Marks that were refused. A record that exists because its codeword could be embedded while others
-- could not has been chosen among them, and its bound is charged for that: per host (by its geometry,
-- for a comment more makes another file) and owner, how many codewords (or strengths of one) were tried
-- and thrown away since the last record.
CREATE TABLE tries (
    geometry  BLOB NOT NULL CHECK (length(geometry) = 32),
    owner_id  TEXT NOT NULL,
    refused   INTEGER NOT NULL CHECK (refused >= 0),
    PRIMARY KEY (geometry, owner_id)
) STRICT;
-- How many were thrown away before this record.
ALTER TABLE watermarks ADD COLUMN refused_before INTEGER NOT NULL DEFAULT 0;
-- For counting the marks of one host for one owner, which are charged, too, when one is asked about.
CREATE INDEX watermarks_by_host ON watermarks (coalesce(host_geometry, host_sha256), owner_id);
