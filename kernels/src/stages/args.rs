//! Structs of kernel arguments other than buffers: one struct per kernel, passed by value as its first argument. The launchers
//! declare them; `cl/lib/args.h` is generated from these declarations.

/// A struct of arguments as the device sees it.
#[cfg(test)]
pub(crate) struct Declaration {
    /// Name of the struct.
    pub name: &'static str,
    /// Its definition in OpenCL C.
    pub text: String,
    /// Size, then the offset of each field.
    pub layout: Vec<usize>,
    /// Names of the fields.
    pub fields: Vec<&'static str>,
}

/// Name of a field's type in OpenCL C.
#[cfg(test)]
pub(crate) fn device_type(rust: &'static str) -> &'static str {
    match rust {
        "u32" => "uint",
        "f32" => "float",
        structs => structs,
    }
}

/// Declares the structs of arguments of a stage's kernels. A stage without any must still invoke it: `kernel_args! {}`.
macro_rules! kernel_args {
    ($($(#[doc = $doc:literal])* $name:ident { $($(#[doc = $field_doc:literal])* $field:ident: $kind:ident),* $(,)? })*) => {
        $(
            $(#[doc = $doc])*
            #[repr(C)]
            #[derive(Clone, Copy)]
            pub(crate) struct $name { $($(#[doc = $field_doc])* pub $field: $kind),* }

            impl $crate::context::ByValue for $name {}
        )*

        /// The structs of this stage.
        #[cfg(test)]
        pub(crate) fn declarations() -> Vec<$crate::stages::args::Declaration> {
            vec![$({
                let mut text = String::new();
                $(text += &format!("//{}\n", $doc);)*
                text += "typedef struct {\n";
                $(
                    text += &format!(
                        "    {} {};", $crate::stages::args::device_type(stringify!($kind)), stringify!($field)
                    );
                    $(text += &format!(" //{}", $field_doc);)*
                    text += "\n";
                )*
                text += &format!("}} {};\n", stringify!($name));
                $crate::stages::args::Declaration {
                    name: stringify!($name),
                    text,
                    layout: vec![size_of::<$name>(), $(std::mem::offset_of!($name, $field)),*],
                    fields: vec![$(stringify!($field)),*],
                }
            }),*]
        }
    };
}
pub(crate) use kernel_args;
