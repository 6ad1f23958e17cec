-- Which calibration holds for a camera now: not the newest one, but the one that was approved last.
CREATE TABLE current_calibrations (
    camera TEXT PRIMARY KEY,
    calibration TEXT NOT NULL REFERENCES calibrations (id)
) STRICT;
