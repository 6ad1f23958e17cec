//! Calibrations in other programs' formats, one file a format. Uses geometry, calibration and document.
