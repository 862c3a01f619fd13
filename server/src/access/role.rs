//! Roles, and the roles that each request requires.

use std::fmt;
use std::str::FromStr;

use axum::http::Method;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A role of a user: a set of operations that the user may request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Open volumes and look at them.
    View,
    /// Change what is shown of volumes; includes `View`.
    Edit,
    /// Have surfaces as files, one by one or as batch jobs.
    Export,
    /// Bring volumes to the server.
    Upload,
    /// Send time steps of a simulation that runs: nothing takes them yet.
    Push,
    /// All of these, and what is about the server itself.
    Admin,
}

impl Role {
    /// All roles.
    pub const ALL: [Self; 6] = [
        Self::View,
        Self::Edit,
        Self::Export,
        Self::Upload,
        Self::Push,
        Self::Admin,
    ];

    /// Returns the name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Edit => "edit",
            Self::Export => "export",
            Self::Upload => "upload",
            Self::Push => "push",
            Self::Admin => "admin",
        }
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let role = Self::ALL.into_iter().find(|role| role.name() == text);
        role.ok_or_else(|| format!("{text:?}, expected view, edit, export, upload, push or admin"))
    }
}

/// A set of roles. The bit of a role is at the position of its discriminant.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Vec<Role>", into = "Vec<Role>")]
pub struct Roles(u8);

impl Roles {
    /// All roles, because `Admin` includes the others.
    pub const ALL: Self = Self(1 << Role::Admin as u8);

    /// Whether the set is empty.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether these roles include `role`. `Admin` includes all roles, and `Edit` includes `View`.
    pub fn include(self, role: Role) -> bool {
        let has = |role: Role| self.0 & (1 << role as u8) != 0;
        has(role) || has(Role::Admin) || (role == Role::View && has(Role::Edit))
    }
}

impl From<Vec<Role>> for Roles {
    fn from(roles: Vec<Role>) -> Self {
        Self(roles.into_iter().fold(0, |bits, role| bits | (1 << role as u8)))
    }
}

impl From<Roles> for Vec<Role> {
    fn from(roles: Roles) -> Self {
        let all = Role::ALL.into_iter();
        all.filter(|&role| roles.0 & (1 << role as u8) != 0).collect()
    }
}

impl fmt::Display for Roles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = Vec::from(*self).into_iter().map(Role::name).collect();
        f.write_str(&names.join(", "))
    }
}

impl fmt::Debug for Roles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// The authorization that a request requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RequiredAccess {
    /// No authentication. The response contains nothing about volumes.
    Nothing,
    /// A token with any roles.
    Token,
    /// One of these roles.
    OneOf(&'static [Role]),
}

/// Returns the authorization that a request requires. Paths outside `/api/` are the page, the probes and the metrics. All routes below
/// `/api/` that are not listed here require `admin`, so that a forgotten route is not public.
pub(super) fn required_access(method: &Method, path: &str) -> RequiredAccess {
    use Role::{Admin, Export, Upload, View};
    if !path.starts_with("/api/") {
        return if path == "/metrics" {
            RequiredAccess::OneOf(&[Admin])
        } else {
            RequiredAccess::Nothing
        };
    }
    let Some(route) = path.strip_prefix("/api/v1/") else {
        return RequiredAccess::OneOf(&[Admin]);
    };
    let parts: Vec<&str> = route.split('/').collect();
    match parts[..] {
        ["openapi.json"] => RequiredAccess::Nothing,
        // The origins whose pages may embed the viewer are not secret, because a header of each response lists them too.
        ["embed"] if *method == Method::GET => RequiredAccess::Nothing,
        // Exchanges a token for a cookie. The handler checks the token itself.
        ["session"] if *method == Method::POST => RequiredAccess::Nothing,
        // A user who signs in has no session yet.
        ["oidc"] | ["oidc", "login" | "callback"] if *method == Method::GET => RequiredAccess::Nothing,
        ["session"] => RequiredAccess::Token,
        ["volumes"] | ["volumes", _] | ["unreadable"] => RequiredAccess::OneOf(&[View, Export]),
        ["volumes", _, "slices" | "overview" | "expression"] | ["stream"] | ["tickets"] | ["embed-tokens"] => {
            RequiredAccess::OneOf(&[View])
        }
        ["extract"] | ["jobs", ..] => RequiredAccess::OneOf(&[Export]),
        ["uploads", ..] => RequiredAccess::OneOf(&[Upload]),
        _ => RequiredAccess::OneOf(&[Admin]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_suffice_for_what_they_are_named_after_and_no_more() {
        let roles = |names: &str| -> Roles {
            let roles: Vec<Role> = names.split(' ').map(|name| name.parse().expect("a role")).collect();
            roles.into()
        };
        for (given, may) in [
            ("view", "view"),
            ("edit", "view edit"),
            ("export", "export"),
            ("upload push", "upload push"),
            ("admin", "view edit export upload push admin"),
        ] {
            let allowed: Vec<Role> = Role::ALL
                .into_iter()
                .filter(|&role| roles(given).include(role))
                .collect();
            assert_eq!(Roles::from(allowed), roles(may), "{given}");
        }
        assert_eq!(roles("export view").to_string(), "view, export");
        assert!("root".parse::<Role>().unwrap_err().contains("expected view, edit"));
        let text = serde_json::to_string(&roles("view export")).expect("JSON");
        assert_eq!(text, r#"["view","export"]"#);
        assert_eq!(
            serde_json::from_str::<Roles>(&text).expect("roles"),
            roles("view export")
        );
    }

    #[test]
    fn what_is_not_listed_is_for_administrators() {
        for path in [
            "/metrics",
            "/api/v1/metrics",
            "/api/v2/volumes",
            "/api/",
            "/api/v1/volumes/head/other",
            "/api/v1/%6aobs",
        ] {
            assert_eq!(
                required_access(&Method::GET, path),
                RequiredAccess::OneOf(&[Role::Admin]),
                "{path}"
            );
        }
    }
}
