-- What each row held when it was written, as a CRC-32: a byte that the disk changed is noticed. NULL for older rows.
ALTER TABLE sessions ADD COLUMN checksum INTEGER;
ALTER TABLE calibrations ADD COLUMN checksum INTEGER;
ALTER TABLE views ADD COLUMN checksum INTEGER;
ALTER TABLE views ADD COLUMN picture_checksum INTEGER;

-- Every calibration that was ever approved: it and its session are never pruned.
CREATE TABLE approvals (
    calibration TEXT PRIMARY KEY REFERENCES calibrations (id)
) STRICT;
INSERT INTO approvals SELECT DISTINCT calibration FROM current_calibrations;
