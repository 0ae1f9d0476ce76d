-- How many verifications have asked about a record: those that named it, or so few that it was nearly
-- named. Each further question is charged to its bound.
CREATE TABLE questions (
    watermark_id  TEXT PRIMARY KEY NOT NULL,
    asked         INTEGER NOT NULL CHECK (asked > 0)
) STRICT;
