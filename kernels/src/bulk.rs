//! Arrays in messages between processes of one machine: their bytes as they are in memory, which takes one copy each way. For
//! `serde(with)`.

use crate::SharedSlice;
use bytemuck::Pod;
use serde::Serializer;
use serde::de::{Deserializer, Error, Visitor};
use std::fmt;
use std::marker::PhantomData;
use std::ops::Deref;

/// An array of plain numbers.
pub trait Bulk: Deref<Target = [Self::Item]> + From<Vec<Self::Item>> {
    /// Type of its elements.
    type Item: Pod;
}

impl<T: Pod> Bulk for Vec<T> {
    type Item = T;
}

impl<T: Pod> Bulk for SharedSlice<T> {
    type Item = T;
}

/// Serializes an array as bytes.
///
/// # Errors
/// Those of the serializer.
pub fn serialize<A: Bulk, S: Serializer>(array: &A, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(bytemuck::cast_slice(array))
}

/// Deserializes an array of bytes.
///
/// # Errors
/// The bytes are no whole number of elements, and those of the deserializer.
pub fn deserialize<'de, A: Bulk, D: Deserializer<'de>>(deserializer: D) -> Result<A, D::Error> {
    deserializer.deserialize_bytes(Elements(PhantomData))
}

struct Elements<A>(PhantomData<A>);

impl<A: Bulk> Visitor<'_> for Elements<A> {
    type Value = A;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "elements of {} bytes", size_of::<A::Item>())
    }

    fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<A, E> {
        if !bytes.len().is_multiple_of(size_of::<A::Item>()) {
            return Err(E::invalid_length(bytes.len(), &self));
        }
        Ok(bytemuck::pod_collect_to_vec::<u8, A::Item>(bytes).into())
    }
}
