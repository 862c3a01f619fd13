-- Version 2: surfaces without triangles, measured errors, and notices of files.
ALTER TABLE jobs ADD COLUMN empty INTEGER NOT NULL DEFAULT 0;
-- An extraction's state may be empty, too: its surface has no triangles, and error_detail says why.
-- World units; NULL if nothing was measured.
ALTER TABLE extractions ADD COLUMN error_rms REAL;
ALTER TABLE extractions ADD COLUMN error_max REAL;
-- JSON: a list of what the format could not keep.
ALTER TABLE extractions ADD COLUMN notices TEXT NOT NULL DEFAULT '[]';
