-- One table of views: what a sensor gave in a frame set. The board is looked for in one sensor of a camera, whose views
-- are numbered through the session; what the camera's other sensors gave with them has no number. `camera` is empty where
-- the instrument is one camera.
CREATE TABLE sensor_views (
    session TEXT NOT NULL REFERENCES sessions (id),
    frame_set INTEGER NOT NULL,
    camera TEXT NOT NULL,
    sensor TEXT NOT NULL,
    number INTEGER,
    sequence INTEGER NOT NULL,
    name TEXT,
    host_time_ns INTEGER NOT NULL,
    device_time_ns INTEGER,
    width INTEGER NOT NULL,
    height INTEGER NOT NULL,
    unit_m REAL,
    detection TEXT,
    media_type TEXT NOT NULL,
    picture BLOB NOT NULL,
    PRIMARY KEY (session, frame_set, camera, sensor)
) STRICT;

INSERT INTO sensor_views
SELECT session, coalesce(moment, number), coalesce(camera, ''), 'color', number, sequence, name, host_time_ns, device_time_ns,
    width, height, NULL, detection, media_type, picture
FROM views LEFT JOIN rig_views USING (session, number);

INSERT INTO sensor_views
SELECT views.session, views.number, '', sensor, NULL, sequence, name, host_time_ns, device_time_ns,
    companions.width, companions.height, unit_m, companions.detection, companions.media_type, companions.picture
FROM companions JOIN views USING (session, number);

DROP TABLE companions;
DROP TABLE rig_views;
DROP TABLE views;
ALTER TABLE sensor_views RENAME TO views;
CREATE UNIQUE INDEX views_by_number ON views (session, number);
