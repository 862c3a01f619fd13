-- Version 2: surfaces without triangles, and measured errors.
ALTER TABLE jobs ADD COLUMN empty INTEGER NOT NULL DEFAULT 0;
-- An extraction's state may be empty, too: its surface has no triangles, and error_detail says why.
-- World units; NULL if nothing was measured.
ALTER TABLE extractions ADD COLUMN error_rms REAL;
ALTER TABLE extractions ADD COLUMN error_max REAL;
