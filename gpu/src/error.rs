//! What can go wrong with a graphics processor.

use crate::AdapterDescription;

/// A failure to find, open or use a graphics processor.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// No adapter satisfies the choice.
    #[error("no usable GPU adapter for {wanted}; {}", found_and_remedy(found))]
    NoAdapter {
        /// The choice in words.
        wanted: String,
        /// The adapters there are.
        found: Vec<AdapterDescription>,
    },
    /// The adapter was found but would not open.
    #[error("cannot open GPU adapter {adapter}: {message}")]
    Open {
        /// The adapter.
        adapter: String,
        /// What the driver said.
        message: String,
    },
    /// A shader does not parse or validate.
    #[error("shader {shader}: {message}")]
    Shader {
        /// The composed shader's label.
        shader: String,
        /// Part, line and reason.
        message: String,
    },
    /// A command was refused, or memory ran out on the device.
    #[error("GPU command failed: {message}")]
    Command {
        /// What was reported.
        message: String,
    },
    /// The device was lost (driver reset, unplugged, suspended).
    #[error("GPU device lost: {message}")]
    Lost {
        /// What was reported.
        message: String,
    },
    /// Data larger than the device can hold in one piece.
    #[error("{what} needs {needed}, this GPU adapter offers {available}")]
    TooLarge {
        /// What was to be stored.
        what: String,
        /// How much it needs, with its unit.
        needed: String,
        /// How much there is, with its unit.
        available: String,
    },
}

fn found_and_remedy(found: &[AdapterDescription]) -> String {
    if found.is_empty() {
        return "none was found at all. Install a Vulkan driver: the GPU vendor's, or Mesa's software \
                one (package `mesa-vulkan-drivers` together with `libvulkan1` on Debian 13, Ubuntu \
                24.04 or newer), or point VK_DRIVER_FILES at a driver's JSON file"
            .into();
    }
    let names: Vec<_> = found.iter().map(ToString::to_string).collect();
    format!(
        "adapters found: {}. `any` also takes software adapters, a name picks one of these",
        names.join("; ")
    )
}
