//! Shaders: composition from parts, validation, errors that name the part and the line.

use wgpu::naga;

use crate::{Context, GpuError};

/// A piece of WGSL, usually one file. Declarations may be used before they are made, also across parts.
#[derive(Debug, Clone, Copy)]
pub struct ShaderPart<'a> {
    /// File name, for errors.
    pub name: &'a str,
    /// WGSL text.
    pub source: &'a str,
}

/// A validated shader.
#[derive(Debug, Clone)]
pub struct Shader {
    label: String,
    source: String,
}

impl Shader {
    /// Joins the parts and validates the result for a device without optional capabilities.
    ///
    /// # Errors
    /// [`GpuError::Shader`] with the part and line at fault.
    pub fn compose(label: &str, parts: &[ShaderPart<'_>]) -> Result<Self, GpuError> {
        let source = parts.iter().fold(String::new(), |mut joined, part| {
            joined.push_str(part.source);
            joined.push('\n');
            joined
        });
        let failed = |location: Option<naga::SourceLocation>, rendered: String| GpuError::Shader {
            shader: label.into(),
            message: match location.and_then(|at| locate(parts, at.line_number as usize)) {
                Some((part, line)) => format!("{part}, line {line}: {rendered}"),
                None => rendered,
            },
        };
        let module = naga::front::wgsl::parse_str(&source)
            .map_err(|error| failed(error.location(&source), error.emit_to_string(&source)))?;
        naga::valid::Validator::new(
            naga::valid::ValidationFlags::all(),
            naga::valid::Capabilities::empty(),
        )
        .validate(&module)
        .map_err(|error| failed(error.location(&source), error.emit_to_string(&source)))?;
        Ok(Self { label: label.into(), source })
    }

    /// The joined text.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// Hands the shader to the device.
    pub fn module(&self, context: &Context) -> wgpu::ShaderModule {
        context.device().create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(&self.label),
            source: wgpu::ShaderSource::Wgsl(self.source.as_str().into()),
        })
    }
}

/// The part that holds line `line` (from 1) of the joined text, and the line within it.
fn locate<'a>(parts: &[ShaderPart<'a>], line: usize) -> Option<(&'a str, usize)> {
    let mut before = 0;
    for part in parts {
        // Joining adds one line break to each part.
        let lines = part.source.matches('\n').count() + 1;
        if line <= before + lines {
            return Some((part.name, line - before));
        }
        before += lines;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const HELPERS: ShaderPart<'_> = ShaderPart {
        name: "helpers.wgsl",
        source: "fn twice(x: f32) -> f32 {\n    return 2.0 * x;\n}\n",
    };

    #[test]
    fn parts_see_each_other() {
        let main = ShaderPart {
            name: "main.wgsl",
            source: "fn four_times(x: f32) -> f32 { return twice(twice(x)); }",
        };
        assert!(Shader::compose("both", &[main, HELPERS]).is_ok());
    }

    #[test]
    fn errors_name_part_and_line() {
        let broken = ShaderPart {
            name: "broken.wgsl",
            source: "// fine\nfn f() -> f32 {\n    return thrice(1.0);\n}\n",
        };
        let message = Shader::compose("both", &[HELPERS, broken]).unwrap_err().to_string();
        assert!(message.contains("broken.wgsl, line 3"), "{message}");
    }

    #[test]
    fn type_errors_are_found_without_a_device() {
        let wrong = ShaderPart { name: "wrong.wgsl", source: "fn f() -> u32 { return 1.5; }" };
        assert!(Shader::compose("wrong", &[wrong]).is_err());
    }
}
