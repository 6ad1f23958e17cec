//! Frames on disk: MCAP files and folders of images. Uses geometry and imaging.
