//! Why the graph cannot be joined.

/// What DDS refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DdsError {
    /// No participant could be made.
    #[error(
        "the DDS domain {domain_id} cannot be joined: {detail}; end other participants in it, or choose another domain_id"
    )]
    Join {
        /// The domain.
        domain_id: u16,
        /// What RustDDS said.
        detail: String,
    },
    /// A reader or writer could not be made.
    #[error("{topic} cannot be opened: {detail}")]
    Topic {
        /// Its ROS name.
        topic: String,
        /// What RustDDS said.
        detail: String,
    },
    /// A message could not be sent.
    #[error("nothing can be sent on {topic}: {detail}")]
    Send {
        /// Its ROS name.
        topic: String,
        /// What RustDDS said.
        detail: String,
    },
}
