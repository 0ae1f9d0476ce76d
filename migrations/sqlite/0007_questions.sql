-- What verifications have asked about a record: those that named it, and those whose answer did. Each
-- further question is charged to its bound. The same file asked about in the same way is the same
-- question, however often: it gives the same answer, and no other chance to be wrong.
CREATE TABLE questions (
    watermark_id  TEXT NOT NULL,
    question      BLOB NOT NULL CHECK (length(question) = 32),  -- SHA-256 of file, depth and filters
    nth           INTEGER NOT NULL CHECK (nth > 0),             -- which one about this record, from 1
    PRIMARY KEY (watermark_id, question)
) STRICT, WITHOUT ROWID;
CREATE INDEX questions_in_order ON questions (watermark_id, nth);
