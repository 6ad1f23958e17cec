//! What outlives a kill: sessions, views, calibrations in SQLite. Uses geometry, imaging, calibration and document.
