//! `<default>` classes.

use std::collections::{BTreeMap, HashMap};

use roxmltree::Node;

use crate::import::xml::children;

/// Attributes by element name.
type ByElement = HashMap<String, BTreeMap<String, String>>;

/// Default attributes of every class, what they inherit included.
#[derive(Debug, Clone, Default)]
pub struct Defaults {
    classes: HashMap<String, ByElement>,
}

impl Defaults {
    /// Reads all `<default>` sections of a model.
    pub fn read(mujoco: Node) -> Self {
        let mut defaults = Self::default();
        defaults.classes.insert("main".into(), ByElement::default());
        for section in children(mujoco, "default") {
            defaults.class(section, "main");
        }
        defaults
    }

    fn class(&mut self, node: Node, parent: &str) {
        let name = node.attribute("class").unwrap_or("main").to_owned();
        let mut own = self.classes.get(&name).cloned().unwrap_or_default();
        if name != parent {
            own = self.classes.get(parent).cloned().unwrap_or_default();
        }
        for element in node.children().filter(|n| n.is_element() && !n.has_tag_name("default")) {
            let attributes = own.entry(element.tag_name().name().to_owned()).or_default();
            attributes.extend(element.attributes().map(|a| (a.name().into(), a.value().into())));
        }
        self.classes.insert(name.clone(), own);
        for nested in children(node, "default") {
            self.class(nested, &name);
        }
    }

    /// The attributes of an element: its own, then its class's (its `class`, else the body's
    /// `childclass`, else the main class).
    pub fn of(&self, node: Node, child_class: Option<&str>) -> BTreeMap<String, String> {
        let class = node.attribute("class").or(child_class).unwrap_or("main");
        let class = self.classes.get(class).and_then(|c| c.get(node.tag_name().name()));
        let mut attributes = class.cloned().unwrap_or_default();
        attributes.extend(node.attributes().map(|a| (a.name().to_owned(), a.value().to_owned())));
        attributes
    }
}
