//! The same job as a Slurm array: one task for each part, and one that puts them together.

use std::ffi::OsStr;

/// A batch script for `sbatch`. `command` is the command line that the parts are made with.
pub fn script<S: AsRef<OsStr>>(command: &[S], parts: usize) -> String {
    let words: Vec<String> =
        command.iter().map(|word| quoted(&word.as_ref().to_string_lossy())).collect();
    let (command, last) = (words.join(" "), parts.saturating_sub(1));
    format!(
        "#!/bin/bash
#SBATCH --job-name=akrobat
#SBATCH --array=0-{last}
#SBATCH --requeue
#SBATCH --output=akrobat-%A_%a.log
# A task that is killed is requeued and makes its part anew; parts that are whole are left alone.
# When the array has ended, this puts the parts together (and makes those that are missing):
#   sbatch --dependency=afterany:ARRAY_JOB_ID --wrap {join}
set -euo pipefail
exec {command} --only-shards \"$SLURM_ARRAY_TASK_ID\" --threads \"${{SLURM_CPUS_PER_TASK:-1}}\"
",
        join = quoted(&format!("{command} --join")),
    )
}

/// A word as a POSIX shell reads it back.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_reach_the_shell_as_they_are() {
        for word in ["it's", "a b", "$HOME", "", "plain-word_1.h5", "`id`", "\"x\"\\"] {
            let output = std::process::Command::new("sh")
                .args(["-c", &format!("printf %s {}", quoted(word))])
                .output()
                .unwrap();
            assert_eq!(String::from_utf8_lossy(&output.stdout), word);
        }
    }

    #[test]
    fn the_script_is_valid_and_has_a_task_for_each_part() {
        let script = script(&["akrobat", "render", "my file.h5", "-o", "out"], 12);
        assert!(script.contains("#SBATCH --array=0-11\n"), "{script}");
        assert!(
            script.contains("exec akrobat render 'my file.h5' -o out --only-shards"),
            "{script}"
        );
        let mut check = std::process::Command::new("bash");
        assert!(check.args(["-n", "-c", &script]).status().unwrap().success());
    }
}
