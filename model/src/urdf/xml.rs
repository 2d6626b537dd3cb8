//! Small helpers over `roxmltree`, with errors that carry the line.

use std::path::Path;

use roxmltree::Node;

use crate::pose::from_xyz_rpy;
use crate::{ModelError, Pose};

/// The file being read, for messages.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// The URDF file.
    pub path: &'a Path,
}

impl Context<'_> {
    /// An error about `node`.
    pub fn error(&self, node: Node, message: impl std::fmt::Display) -> ModelError {
        ModelError::invalid(self.path, format!("line {}: {message}", line_of(node)))
    }

    /// A required attribute.
    pub fn attribute<'a>(&self, node: Node<'a, '_>, name: &str) -> Result<&'a str, ModelError> {
        node.attribute(name).ok_or_else(|| {
            self.error(node, format!("{} lacks the attribute \"{name}\"", tag(node)))
        })
    }

    /// A required child element.
    pub fn child<'a, 'i>(
        &self,
        node: Node<'a, 'i>,
        name: &str,
    ) -> Result<Node<'a, 'i>, ModelError> {
        child(node, name).ok_or_else(|| self.error(node, format!("{} lacks <{name}>", tag(node))))
    }

    /// A finite number in an attribute; `None` where the attribute is absent.
    pub fn number(&self, node: Node, name: &str) -> Result<Option<f64>, ModelError> {
        let Some(text) = node.attribute(name) else { return Ok(None) };
        match text.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Some(value)),
            _ => Err(self.error(
                node,
                format!("{} {name}: expected a finite number, got \"{text}\"", tag(node)),
            )),
        }
    }

    /// A required finite number in an attribute.
    pub fn required_number(&self, node: Node, name: &str) -> Result<f64, ModelError> {
        self.attribute(node, name)?;
        Ok(self.number(node, name)?.unwrap_or_default())
    }

    /// `N` finite numbers in an attribute; `None` where the attribute is absent.
    pub fn numbers<const N: usize>(
        &self,
        node: Node,
        name: &str,
    ) -> Result<Option<[f64; N]>, ModelError> {
        let Some(text) = node.attribute(name) else { return Ok(None) };
        let values: Option<Vec<f64>> = text
            .split_whitespace()
            .map(|word| word.parse::<f64>().ok().filter(|v| v.is_finite()))
            .collect();
        match values.and_then(|v| v.try_into().ok()) {
            Some(values) => Ok(Some(values)),
            None => Err(self.error(
                node,
                format!("{} {name}: expected {N} finite numbers, got \"{text}\"", tag(node)),
            )),
        }
    }

    /// The pose of the `<origin>` child; identity where there is none.
    pub fn origin(&self, node: Node) -> Result<Pose, ModelError> {
        let Some(origin) = child(node, "origin") else { return Ok(Pose::identity()) };
        let xyz = self.numbers(origin, "xyz")?.unwrap_or_default();
        let rpy = self.numbers(origin, "rpy")?.unwrap_or_default();
        Ok(from_xyz_rpy(xyz, rpy))
    }
}

/// The 1-based line on which an element starts.
pub fn line_of(node: Node) -> u32 {
    node.document().text_pos_at(node.range().start).row
}

/// `<joint "elbow">` or `<mesh>`, for messages.
pub fn tag(node: Node) -> String {
    let element = node.tag_name().name();
    match node.attribute("name") {
        Some(name) => format!("<{element} \"{name}\">"),
        None => format!("<{element}>"),
    }
}

/// The first child element of this name.
pub fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|n| n.tag_name().name() == name)
}

/// All child elements of this name.
pub fn children<'a, 'i: 'a>(
    node: Node<'a, 'i>,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(move |n| n.tag_name().name() == name)
}
