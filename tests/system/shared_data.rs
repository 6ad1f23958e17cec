//! Real images that lie beside the project, never inside it.

use std::path::{Path, PathBuf};

use crate::not_tested::not_tested;

/// The folder `name` of the real images, found upwards from the project; `None`, loudly, where
/// there are none at all. A folder that is missing among the others is a failure of the test.
pub fn shared_data(name: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .map(|up| up.join("shared/data"))
        .find(|p| p.is_dir());
    let Some(root) = root else {
        not_tested(&format!("the real images of {name}: no shared/data beside the project"));
        return None;
    };
    let folder = root.join(name);
    assert!(folder.is_dir(), "{}: missing, though {} is there", folder.display(), root.display());
    Some(folder)
}
