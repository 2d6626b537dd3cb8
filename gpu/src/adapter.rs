//! Which graphics processor to use.

use std::fmt;
use std::str::FromStr;

use crate::GpuError;

/// The user's choice of adapter. In text form `auto`, `any`, or part of an adapter's name.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum AdapterChoice {
    /// The best real GPU; software adapters are refused.
    #[default]
    Auto,
    /// The best real GPU, or else a software adapter.
    Any,
    /// The first adapter, real or software, whose name or driver contains this text (case is ignored).
    Name(String),
}

impl FromStr for AdapterChoice {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text {
            "auto" => Self::Auto,
            "any" => Self::Any,
            name => Self::Name(name.into()),
        })
    }
}

impl fmt::Display for AdapterChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("`auto` (real hardware only)"),
            Self::Any => f.write_str("`any`"),
            Self::Name(name) => write!(f, "the name \"{name}\""),
        }
    }
}

/// What an adapter is, from the most to the least preferred.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum AdapterKind {
    /// A GPU with its own memory.
    Discrete,
    /// A GPU that shares the processor's memory.
    Integrated,
    /// A GPU seen through a virtual machine.
    Virtual,
    /// Hardware of an unstated kind.
    Other,
    /// A driver that computes on the CPU.
    Software,
}

impl fmt::Display for AdapterKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Discrete => "discrete GPU",
            Self::Integrated => "integrated GPU",
            Self::Virtual => "virtual GPU",
            Self::Other => "other",
            Self::Software => "software",
        })
    }
}

/// An adapter in words, for reports, provenance and errors.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AdapterDescription {
    /// Name of the device.
    pub name: String,
    /// What it is.
    pub kind: AdapterKind,
    /// Graphics interface it is reached through: `vulkan`, `metal`, `dx12`.
    pub interface: String,
    /// Driver name and version.
    pub driver: String,
}

impl AdapterDescription {
    fn of(adapter: &wgpu::Adapter) -> Self {
        let info = adapter.get_info();
        Self {
            name: info.name,
            kind: match info.device_type {
                wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
                wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
                wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
                wgpu::DeviceType::Other => AdapterKind::Other,
                wgpu::DeviceType::Cpu => AdapterKind::Software,
            },
            interface: info.backend.to_str().into(),
            driver: format!("{} {}", info.driver, info.driver_info).trim().into(),
        }
    }

    fn matches(&self, choice: &AdapterChoice) -> bool {
        match choice {
            AdapterChoice::Auto => self.kind != AdapterKind::Software,
            AdapterChoice::Any => true,
            AdapterChoice::Name(pattern) => {
                let pattern = pattern.to_lowercase();
                self.name.to_lowercase().contains(&pattern)
                    || self.driver.to_lowercase().contains(&pattern)
            }
        }
    }
}

impl fmt::Display for AdapterDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}, {}, {})", self.name, self.kind, self.interface, self.driver)
    }
}

/// Every adapter of this machine, best first.
pub fn adapters() -> Vec<AdapterDescription> {
    enumerate(&instance()).into_iter().map(|(description, _)| description).collect()
}

/// The best adapter that satisfies a choice.
///
/// # Errors
/// [`GpuError::NoAdapter`], which lists those there are.
pub(crate) fn choose(
    choice: &AdapterChoice,
) -> Result<(AdapterDescription, wgpu::Adapter), GpuError> {
    let mut candidates = enumerate(&instance());
    match candidates.iter().position(|(description, _)| description.matches(choice)) {
        Some(index) => Ok(candidates.swap_remove(index)),
        None => Err(GpuError::NoAdapter {
            wanted: choice.to_string(),
            found: candidates.into_iter().map(|(description, _)| description).collect(),
        }),
    }
}

fn instance() -> wgpu::Instance {
    wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::PRIMARY,
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    })
}

fn enumerate(instance: &wgpu::Instance) -> Vec<(AdapterDescription, wgpu::Adapter)> {
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    let mut described: Vec<_> =
        adapters.into_iter().map(|a| (AdapterDescription::of(&a), a)).collect();
    described.sort_by_key(|(description, _)| description.kind);
    described
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter(name: &str, kind: AdapterKind) -> AdapterDescription {
        AdapterDescription {
            name: name.into(),
            kind,
            interface: "vulkan".into(),
            driver: "Mesa 25".into(),
        }
    }

    #[test]
    fn auto_refuses_software_and_any_takes_it() {
        let software = adapter("llvmpipe", AdapterKind::Software);
        assert!(!software.matches(&AdapterChoice::Auto));
        assert!(software.matches(&AdapterChoice::Any));
        assert!(adapter("Arc A770", AdapterKind::Discrete).matches(&AdapterChoice::Auto));
    }

    #[test]
    fn names_match_device_and_driver_in_any_case() {
        let software = adapter("llvmpipe", AdapterKind::Software);
        assert!(software.matches(&"LLVM".parse().unwrap()));
        assert!(software.matches(&"mesa".parse().unwrap()));
        assert!(!software.matches(&"radeon".parse().unwrap()));
    }

    #[test]
    fn the_error_lists_the_adapters_or_the_remedy() {
        let wanted = AdapterChoice::Auto.to_string();
        let found = vec![adapter("llvmpipe", AdapterKind::Software)];
        let some = GpuError::NoAdapter { wanted: wanted.clone(), found }.to_string();
        assert!(some.contains("llvmpipe") && some.contains("`any`"), "{some}");
        let none = GpuError::NoAdapter { wanted, found: Vec::new() }.to_string();
        assert!(none.contains("mesa-vulkan-drivers"), "{none}");
    }
}
