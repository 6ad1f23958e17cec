-- Which camera of a rig a view is of, and of which moment; those of one moment were seen together.
CREATE TABLE rig_views (
    session TEXT NOT NULL,
    number INTEGER NOT NULL,
    camera TEXT NOT NULL,
    moment INTEGER NOT NULL,
    PRIMARY KEY (session, number),
    FOREIGN KEY (session, number) REFERENCES views (session, number)
) STRICT;
