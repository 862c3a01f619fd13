//! Serialization of types whose values fulfil conditions.

/// Implements `Serialize` and `Deserialize` for a type that derives both with `serde(remote = "Self")`. A value that `check` refuses
/// cannot be deserialized.
#[macro_export]
macro_rules! checked_serde {
    ($type:ty, $check:expr) => {
        impl ::serde::Serialize for $type {
            fn serialize<S: ::serde::Serializer>(&self, serializer: S) -> ::std::result::Result<S::Ok, S::Error> {
                <$type>::serialize(self, serializer)
            }
        }

        impl<'de> ::serde::Deserialize<'de> for $type {
            fn deserialize<D: ::serde::Deserializer<'de>>(deserializer: D) -> ::std::result::Result<Self, D::Error> {
                let value = <$type>::deserialize(deserializer)?;
                let check: fn(&$type) -> ::std::result::Result<_, _> = $check;
                match check(&value) {
                    Ok(_) => Ok(value),
                    Err(error) => Err(::serde::de::Error::custom(error)),
                }
            }
        }
    };
}
