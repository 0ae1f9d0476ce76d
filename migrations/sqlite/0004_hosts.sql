-- What the short list of a verification is found by: per host file a sketch of its geometry (hashes of
-- vertex neighbourhoods and an outline, see registration/sketch.rs). Copies for many recipients of one
-- host share it. Nothing in it depends on a mark. A row whose host no record has any more is harmless.
CREATE TABLE hosts (
    host_sha256  BLOB PRIMARY KEY NOT NULL CHECK (length(host_sha256) = 32),
    sketch       BLOB NOT NULL
) STRICT;
