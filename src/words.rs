//! Numbers in sentences.

/// A count with its noun: `1 frame`, `3 frames`.
pub fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// The form of a verb that follows a count.
pub fn verb<'a>(count: usize, singular: &'a str, plural: &'a str) -> &'a str {
    if count == 1 { singular } else { plural }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_is_singular() {
        let sentence = |n| format!("{} {} left out", counted(n, "frame"), verb(n, "is", "are"));
        assert_eq!([0, 1, 2].map(sentence), ["0 frames are left out", "1 frame is left out", "2 frames are left out"]);
    }
}
