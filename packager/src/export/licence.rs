//! Which licences forbid commercial use.

use crate::dataset::Licence;

/// The assets whose licence forbids commercial use, by their SPDX expression or its words.
///
/// An expression of alternatives (`A OR B`) forbids it only where every alternative does.
pub fn non_commercial(licences: &[Licence]) -> Vec<&Licence> {
    licences.iter().filter(|licence| forbids_commerce(&licence.license)).collect()
}

fn forbids_commerce(expression: &str) -> bool {
    let plain = expression.replace(['(', ')'], " ");
    let mut alternatives = plain.split(" OR ").filter(|part| !part.trim().is_empty()).peekable();
    alternatives.peek().is_some() && alternatives.all(says_non_commercial)
}

fn says_non_commercial(part: &str) -> bool {
    let lower = part.to_lowercase();
    let spaced = lower.replace(['-', '_'], " ");
    lower.split(|c: char| !c.is_ascii_alphanumeric()).any(|word| word == "nc")
        || ["non commercial", "noncommercial", "research only", "academic"]
            .iter()
            .any(|words| spaced.contains(words))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn non_commercial_licences_are_recognised() {
        for expression in [
            "CC-BY-NC-ND-3.0",
            "CC-BY-NC-4.0 AND MIT",
            "PolyForm-Noncommercial-1.0.0",
            "Non-commercial research only",
            "(CC-BY-NC-4.0 OR CC-BY-NC-SA-4.0)",
        ] {
            assert!(forbids_commerce(expression), "{expression}");
        }
        for expression in
            ["BSD-3-Clause", "Apache-2.0 AND BSD-3-Clause", "MIT OR CC-BY-NC-4.0", "NCSA", ""]
        {
            assert!(!forbids_commerce(expression), "{expression}");
        }
    }
}
