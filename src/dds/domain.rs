//! Which graph, where the configuration does not say: as ROS 2's own programs take it from their
//! environment.

use std::env;

/// Which graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Domain {
    /// ROS's `ROS_DOMAIN_ID`. Default: 0.
    pub id: u16,
    /// Whether only this machine is spoken to, by its loopback interface. Default: not.
    pub is_local: bool,
}

impl Domain {
    /// The domain `id`; the one of `ROS_DOMAIN_ID` where it is `None`. `ROS_LOCALHOST_ONLY=1`
    /// (Humble) and `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` (since Iron) keep it on this machine.
    pub fn of_environment(id: Option<u16>) -> Self {
        Self::of(id, |name| env::var(name).ok())
    }

    fn of(id: Option<u16>, variable: impl Fn(&str) -> Option<String>) -> Self {
        let named = || variable("ROS_DOMAIN_ID")?.trim().parse().ok();
        let is = |name: &str, value: &str| {
            variable(name).is_some_and(|set| set.trim().eq_ignore_ascii_case(value))
        };
        Self {
            id: id.or_else(named).unwrap_or(0),
            is_local: is("ROS_LOCALHOST_ONLY", "1")
                || is("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_wins_over_the_environment() {
        let variables = |name: &str| match name {
            "ROS_DOMAIN_ID" => Some("42".to_owned()),
            "ROS_LOCALHOST_ONLY" => Some("1".to_owned()),
            _ => None,
        };
        assert_eq!(Domain::of(None, variables), Domain { id: 42, is_local: true });
        assert_eq!(Domain::of(Some(7), variables).id, 7);
        assert_eq!(Domain::of(None, |_| None), Domain::default());
        let jazzy =
            |name: &str| (name == "ROS_AUTOMATIC_DISCOVERY_RANGE").then(|| "localhost".to_owned());
        assert_eq!(Domain::of(None, jazzy), Domain { id: 0, is_local: true });
    }
}
