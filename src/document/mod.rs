//! The documents of the contract, one schema for the command line, HTTP and the store. Uses geometry, imaging and
//! calibration.
