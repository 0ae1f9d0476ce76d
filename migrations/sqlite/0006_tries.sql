-- Marks that were refused. A record that exists because its codeword could be embedded while others
-- could not has been chosen among them, and its bound is charged for that: per host and owner, how many
-- codewords (or strengths of one) were tried and thrown away since the last record.
CREATE TABLE tries (
    host_sha256  BLOB NOT NULL CHECK (length(host_sha256) = 32),
    owner_id     TEXT NOT NULL,
    refused      INTEGER NOT NULL CHECK (refused >= 0),
    PRIMARY KEY (host_sha256, owner_id)
) STRICT;
-- How many were thrown away before this record.
ALTER TABLE watermarks ADD COLUMN refused_before INTEGER NOT NULL DEFAULT 0;
-- For counting the marks of one host for one owner, which are charged, too, when one is asked about.
CREATE INDEX watermarks_by_host ON watermarks (host_sha256, owner_id);
