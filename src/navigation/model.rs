//! What a filter rests on.

use super::settings::Settings;
use super::states::Layout;

/// The sensors, and the states that they make.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Model {
    pub settings: Settings,
    pub layout: Layout,
}
