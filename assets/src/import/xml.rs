//! Small helpers for XML formats.

use std::path::Path;

use akrobat_model::ModelError;
use roxmltree::{Document, Node, ParsingOptions};

/// Parses a document.
pub fn parse<'a>(path: &Path, text: &'a str) -> Result<Document<'a>, ModelError> {
    let options = ParsingOptions { allow_dtd: true, ..Default::default() };
    Document::parse_with_options(text, options)
        .map_err(|e| ModelError::invalid(path, format!("line {}: malformed XML: {e}", e.pos().row)))
}

/// Children of a name.
pub fn children<'a, 'i: 'a>(
    node: Node<'a, 'i>,
    name: &'a str,
) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(move |c| c.has_tag_name(name))
}

/// The first child of a name.
pub fn child<'a, 'i: 'a>(node: Node<'a, 'i>, name: &'a str) -> Option<Node<'a, 'i>> {
    children(node, name).next()
}

/// Finite numbers separated by spaces.
///
/// # Errors
/// What was expected, and the text.
pub fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let parse = |word: &str| word.parse().ok().filter(|v: &f64| v.is_finite());
    text.split_whitespace()
        .map(parse)
        .collect::<Option<_>>()
        .ok_or_else(|| format!("expected finite numbers, got \"{text}\""))
}

/// An error about a node.
pub fn error(path: &Path, node: Node, message: impl AsRef<str>) -> ModelError {
    let line = node.document().text_pos_at(node.range().start).row;
    let tag = node.tag_name().name();
    ModelError::invalid(path, format!("line {line}: <{tag}>: {}", message.as_ref()))
}
