//! Binary forms of types whose JSON leaves out fields or has no tags, which formats that do not describe themselves cannot read. For
//! `serde(with)`.

use serde::de::{DeserializeOwned, Deserializer, Error};
use serde::{Deserialize, Serialize, Serializer};

use super::camera::CameraJson;
use super::interest::{BoxJson, InterestJson, SphereJson};
use super::quality::{Budget, Distance, ErrorLimit, MaxError, ShareBudget, TriangleBudget};

/// A type with a binary form.
pub(super) trait Binary: Sized {
    /// The form, which holds the same values.
    type Form: Serialize + DeserializeOwned;

    fn to_form(&self) -> Self::Form;

    /// Returns the value of a form; `None` if the form is not one of this type.
    fn from_form(form: Self::Form) -> Option<Self>;
}

pub(super) fn serialize<T: Binary, S: Serializer>(value: &T, serializer: S) -> Result<S::Ok, S::Error> {
    value.to_form().serialize(serializer)
}

pub(super) fn deserialize<'de, T: Binary, D: Deserializer<'de>>(deserializer: D) -> Result<T, D::Error> {
    let form = T::Form::deserialize(deserializer)?;
    T::from_form(form).ok_or_else(|| D::Error::custom("a value of another type"))
}

impl<T: Binary> Binary for Option<T> {
    type Form = Option<T::Form>;

    fn to_form(&self) -> Self::Form {
        self.as_ref().map(T::to_form)
    }

    fn from_form(form: Self::Form) -> Option<Self> {
        match form {
            Some(form) => T::from_form(form).map(Some),
            None => Some(None),
        }
    }
}

impl<T: Binary> Binary for Box<T> {
    type Form = T::Form;

    fn to_form(&self) -> Self::Form {
        self.as_ref().to_form()
    }

    fn from_form(form: Self::Form) -> Option<Self> {
        T::from_form(form).map(Box::new)
    }
}

impl<T: Binary> Binary for Vec<T> {
    type Form = Vec<T::Form>;

    fn to_form(&self) -> Self::Form {
        self.iter().map(T::to_form).collect()
    }

    fn from_form(form: Self::Form) -> Option<Self> {
        form.into_iter().map(T::from_form).collect()
    }
}

/// A limit on an error.
#[derive(Serialize, Deserialize)]
pub(super) enum Limit {
    Auto,
    None,
    World(f32),
    Spacings(f32),
    Pixels(f32),
}

impl From<Distance> for Limit {
    fn from(distance: Distance) -> Self {
        match distance {
            Distance::World(distance) => Self::World(distance),
            Distance::Spacings(n) => Self::Spacings(n),
        }
    }
}

impl Binary for ErrorLimit {
    type Form = Limit;

    fn to_form(&self) -> Limit {
        match *self {
            Self::Distance(distance) => distance.into(),
            Self::Pixels(pixels) => Limit::Pixels(pixels),
        }
    }

    fn from_form(form: Limit) -> Option<Self> {
        match form {
            Limit::World(distance) => Some(Self::Distance(Distance::World(distance))),
            Limit::Spacings(n) => Some(Self::Distance(Distance::Spacings(n))),
            Limit::Pixels(pixels) => Some(Self::Pixels(pixels)),
            Limit::Auto | Limit::None => None,
        }
    }
}

impl Binary for MaxError {
    type Form = Limit;

    fn to_form(&self) -> Limit {
        match *self {
            Self::Auto => Limit::Auto,
            Self::None => Limit::None,
            Self::At(distance) => distance.into(),
        }
    }

    fn from_form(form: Limit) -> Option<Self> {
        match form {
            Limit::Auto => Some(Self::Auto),
            Limit::None => Some(Self::None),
            Limit::World(distance) => Some(Self::At(Distance::World(distance))),
            Limit::Spacings(n) => Some(Self::At(Distance::Spacings(n))),
            Limit::Pixels(_) => None,
        }
    }
}

/// A budget.
#[derive(Serialize, Deserialize)]
pub(super) enum Size {
    Triangles(u64),
    Share(f64, Option<u64>),
    Bytes(u64),
}

impl Binary for Budget {
    type Form = Size;

    fn to_form(&self) -> Size {
        match *self {
            Self::Triangles(TriangleBudget::AtMost(triangles)) => Size::Triangles(triangles),
            Self::Triangles(TriangleBudget::Share(ShareBudget { share, max })) => Size::Share(share, max),
            Self::Bytes(bytes) => Size::Bytes(bytes),
        }
    }

    fn from_form(form: Size) -> Option<Self> {
        Some(match form {
            Size::Triangles(triangles) => Self::Triangles(TriangleBudget::AtMost(triangles)),
            Size::Share(share, max) => Self::Triangles(TriangleBudget::Share(ShareBudget { share, max })),
            Size::Bytes(bytes) => Self::Bytes(bytes),
        })
    }
}

impl Binary for InterestJson {
    type Form = (Option<SphereJson>, Option<BoxJson>, f32);

    fn to_form(&self) -> Self::Form {
        (self.sphere, self.cuboid, self.importance)
    }

    fn from_form((sphere, cuboid, importance): Self::Form) -> Option<Self> {
        Some(Self {
            sphere,
            cuboid,
            importance,
        })
    }
}

impl Binary for CameraJson {
    type Form = ([[f64; 3]; 3], Option<f64>, Option<f64>, [u32; 2]);

    fn to_form(&self) -> Self::Form {
        let vectors = [self.position, self.target, self.up];
        (vectors, self.fov, self.height, self.viewport)
    }

    fn from_form(([position, target, up], fov, height, viewport): Self::Form) -> Option<Self> {
        Some(Self {
            position,
            target,
            up,
            fov,
            height,
            viewport,
        })
    }
}
