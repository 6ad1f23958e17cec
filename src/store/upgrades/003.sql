-- What a view's other sensors gave at the same moment: the board in infrared, the depth picture.
CREATE TABLE companions (
    session TEXT NOT NULL,
    number INTEGER NOT NULL,
    sensor TEXT NOT NULL,
    width INTEGER NOT NULL,
    height INTEGER NOT NULL,
    unit_m REAL,
    detection TEXT,
    media_type TEXT NOT NULL,
    picture BLOB NOT NULL,
    PRIMARY KEY (session, number, sensor),
    FOREIGN KEY (session, number) REFERENCES views (session, number)
) STRICT;
