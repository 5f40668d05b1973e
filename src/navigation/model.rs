//! The filter's model: settings and layout of its states.

use super::settings::NavigationSettings;
use super::states::Layout;

/// The sensors, and the states that they make.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Model {
    pub settings: NavigationSettings,
    pub layout: Layout,
}
