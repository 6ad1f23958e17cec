-- What the readings of depth mean, as JSON: a unit, or raw disparity, and the reading that means none. Rows of older stores
-- have a unit or nothing.
ALTER TABLE views ADD COLUMN depth_encoding TEXT;
