//! Classes of things: how they are called in other collections, and how large they usually are.

/// A class by the names that collections use for it, and its usual height, metres: the middle of common
/// products, as furniture and appliance makers list them.
struct Class {
    name: &'static str,
    aliases: &'static [&'static str],
    height_m: f64,
}

const CLASSES: &[Class] = &[
    class("box", &[], 0.25),
    class("bucket", &[], 0.30),
    class("cabinet", &["storagefurniture", "kitchencabinet", "singlecabinet", "sideboard"], 0.85),
    class("chair", &["foldingchair", "diningchair"], 0.90),
    class("coffee_machine", &["coffeemachine", "coffeemaker"], 0.35),
    class("dishwasher", &[], 0.85),
    class("dispenser", &[], 0.22),
    class("door", &["doorway", "paneldoor", "glasspaneldoor"], 2.05),
    class("drawer", &["drawerunit", "dresser"], 0.80),
    class("faucet", &["tap"], 0.30),
    class("kettle", &[], 0.24),
    class("kitchen_pot", &["kitchenpot", "pot"], 0.20),
    class("lamp", &["desklamp"], 0.50),
    class("laptop", &[], 0.25),
    class("microwave", &["microwaveoven"], 0.30),
    class("oven", &["stove", "range"], 0.90),
    class("refrigerator", &["fridge", "beveragefridge"], 1.70),
    class("safe", &[], 0.45),
    class("suitcase", &[], 0.65),
    class("table", &["desk", "diningtable"], 0.75),
    class("toaster", &[], 0.20),
    class("toilet", &[], 0.75),
    class("trash_can", &["trashcan", "trash", "garbagecan"], 0.60),
    class("washing_machine", &["washingmachine", "washer"], 0.85),
    class("window", &[], 1.20),
];

const fn class(name: &'static str, aliases: &'static [&'static str], height_m: f64) -> Class {
    Class { name, aliases, height_m }
}

fn find(name: &str) -> Option<&'static Class> {
    let plain: String =
        name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect();
    let is_class = |c: &&Class| c.name.replace('_', "") == plain || c.aliases.contains(&&*plain);
    CLASSES.iter().find(is_class)
}

/// The class that a collection's name stands for; the name itself, lower case, where it is not listed.
pub fn canonical(name: &str) -> String {
    find(name).map_or_else(|| name.to_lowercase().replace([' ', '-'], "_"), |c| c.name.to_owned())
}

/// Usual height of a class, metres.
pub fn height_m(name: &str) -> Option<f64> {
    find(name).map(|class| class.height_m)
}

/// The class of a file or folder name: its longest run of leading words that is a class, as in
/// `trash_can_1001`, else its first word.
pub fn of_file_name(name: &str) -> String {
    let words: Vec<&str> = name.split(['_', '-', ' ', '.']).collect();
    let known = (1..=words.len()).rev().find_map(|n| find(&words[..n].concat()));
    known.map_or_else(|| words[0].to_lowercase(), |class| class.name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn collections_agree_on_classes() {
        assert_eq!(canonical("StorageFurniture"), "cabinet");
        assert_eq!(canonical("Washing Machine"), "washing_machine");
        assert_eq!(canonical("beverage_fridge"), "refrigerator");
        assert_eq!(canonical("Sofa Bed"), "sofa_bed");
        assert_eq!(of_file_name("trash_can_1001"), "trash_can");
        assert_eq!(of_file_name("sofa_03"), "sofa");
    }
}
