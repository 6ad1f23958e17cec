//! Where it becomes live: threads, channels, clocks. Uses every layer below.
