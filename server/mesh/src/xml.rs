//! Escapes texts for XML.

use std::borrow::Cow;

use quick_xml::escape::escape;

/// Escapes a text for elements and attributes. Omits characters that XML 1.0 does not allow.
pub fn escaped(text: &str) -> Cow<'_, str> {
    let is_allowed =
        |c: char| matches!(c, '\t' | '\n' | '\r' | ' '..='\u{d7ff}' | '\u{e000}'..='\u{fffd}' | '\u{10000}'..);
    if text.chars().all(is_allowed) {
        return escape(text);
    }
    let allowed: String = text.chars().filter(|&c| is_allowed(c)).collect();
    Cow::Owned(escape(allowed.as_str()).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_xml_cannot_hold_is_left_out() {
        assert_eq!(escaped("a<b & \"c\"\u{0}\u{1b}"), "a&lt;b &amp; &quot;c&quot;");
        assert_eq!(escaped("µ"), "µ");
    }
}
