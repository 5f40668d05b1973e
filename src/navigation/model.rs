//! The filter's model: settings and layout of its states.

use super::settings::NavigationSettings;
use super::states::Layout;

/// The settings of the sensors, and the resulting states.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Model {
    pub settings: NavigationSettings,
    pub layout: Layout,
}
