//! The OpenAPI document, generated from the calls.

use drivetwin_panel::faults::{Rule, Way};
use drivetwin_panel::live;
use utoipa::OpenApi;
use utoipa::openapi::path::{Operation, ParameterIn, PathItem};
use utoipa::openapi::{self, Content, Ref, RefOr, Response};

use super::downloads::Format;
use super::event_stream::{Happened, Lost, ReceivedEvent};
use super::problem::{self, Problem};
use super::terminals::{TerminalOpen, TerminalText};

/// The part of the document that is not derived from the calls.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "drivetwin",
        description = "Control of a bench of emulated drives. Errors are RFC 9457 problem documents. \
                       A request that changes something needs `Content-Type: application/json`, even without a body."
    ),
    components(schemas(
        Problem,
        Format,
        Happened,
        Lost,
        live::Update,
        live::Frame,
        ReceivedEvent,
        Rule,
        TerminalOpen,
        TerminalText,
        Way
    ))
)]
struct Frame;

/// The document without calls.
pub(super) fn begin() -> openapi::OpenApi {
    Frame::openapi()
}

/// Adds the common error responses to each call.
pub(super) fn complete(mut document: openapi::OpenApi) -> openapi::OpenApi {
    for item in document.paths.paths.values_mut() {
        let PathItem { get, put, post, delete, .. } = item;
        for operation in [get, put, post, delete].into_iter().flatten() {
            let has_body = operation.request_body.is_some();
            let names_something = names_something(operation);
            refuse(
                operation,
                "403",
                "The request comes from a web page, or might: its Host is not a loopback address or an allowed name, its Origin is another site, or it changes something without `Content-Type: application/json`.",
            );
            refuse(operation, "422", "The request is well formed but cannot be executed.");
            refuse(
                operation,
                "503",
                "The bench is stopping, a board cannot be reached, or there is no room for one more reader.",
            );
            if names_something {
                refuse(operation, "404", "Unknown name; the detail has the nearest one.");
            }
            if has_body || names_something {
                refuse(operation, "400", "A name is not UTF-8, or the body is not JSON.");
            }
            for response in operation.responses.responses.values_mut() {
                if let RefOr::T(response) = response
                    && response.description.is_empty()
                {
                    response.description =
                        if response.content.is_empty() { "Done." } else { "The present state." }.into();
                }
            }
            if has_body {
                refuse(operation, "408", "The body took too long.");
                refuse(operation, "413", "The body is too long.");
            }
        }
    }
    document
}

/// Returns whether the path of a call contains a name.
fn names_something(operation: &Operation) -> bool {
    operation.parameters.iter().flatten().any(
        |parameter| matches!(parameter, RefOr::T(parameter) if parameter.parameter_in == ParameterIn::Path),
    )
}

/// Adds a problem document for a status, unless the description of the call already has one.
fn refuse(operation: &mut Operation, status: &str, when: &str) {
    operation.responses.responses.entry(status.to_owned()).or_insert_with(|| {
        let mut response = Response::new(when);
        let problem = Content::new(Some(Ref::from_schema_name("Problem")));
        response.content.insert(problem::MEDIA_TYPE.to_owned(), problem.into());
        response.into()
    });
}

#[cfg(test)]
mod tests {
    use drivetwin_firmware::device::Duration;
    use drivetwin_sim::line::faults::{BAUDS, LONGEST_DELAY, LineFaults};
    use serde_json::{Value, json};

    fn document() -> Value {
        let (_, document) = super::super::calls().split_for_parts();
        serde_json::to_value(super::complete(document)).unwrap()
    }

    /// The calls of the document, each with its path and method.
    fn calls() -> Vec<(String, Value)> {
        let document = document();
        let paths = document["paths"].as_object().unwrap();
        let calls = paths.iter().flat_map(|(path, item)| {
            let methods = item.as_object().unwrap().iter();
            methods.map(move |(method, call)| (format!("{method} {path}"), call.clone()))
        });
        calls.collect()
    }

    #[test]
    fn every_call_is_there() {
        let mut names: Vec<String> = calls().into_iter().map(|(name, _)| name).collect();
        names.sort();
        let expected = [
            "delete /api/drives/{name}/faults/{fault}",
            "get /api/bench",
            "get /api/buses",
            "get /api/drives/{name}",
            "get /api/drives/{name}/memory",
            "get /api/drives/{name}/ports/{port}/terminal",
            "get /api/drives/{name}/received",
            "get /api/events",
            "get /api/kinds/{kind}",
            "get /api/live",
            "get /api/trace",
            "post /api/drives/{name}/encoder",
            "post /api/drives/{name}/pins/{pin}/pulses",
            "post /api/drives/{name}/power",
            "post /api/scenario",
            "post /api/terminals/{id}",
            "post /api/time/advance",
            "put /api/buses/{name}/faults",
            "put /api/drives/{name}/faults/{fault}",
            "put /api/drives/{name}/kind",
            "put /api/drives/{name}/memory",
            "put /api/drives/{name}/pins/{pin}",
            "put /api/drives/{name}/registers/{register}",
            "put /api/time",
        ];
        assert_eq!(names, expected);
    }

    #[test]
    fn every_refusal_is_a_problem_document_and_every_call_lists_its_own() {
        for (name, call) in calls() {
            let responses = call["responses"].as_object().unwrap();
            let has = |status: &str| responses.contains_key(status);
            assert!(has("403") && has("422") && has("503"), "{name}");
            assert_eq!(has("404"), name.contains('{'), "{name}");
            assert_eq!(has("408") && has("413"), call.get("requestBody").is_some(), "{name}");
            for (status, response) in responses {
                assert_ne!(response["description"], "", "{name} {status}");
                let problem = &response["content"]["application/problem+json"]["schema"]["$ref"];
                assert_eq!(
                    problem == "#/components/schemas/Problem",
                    status.starts_with(['4', '5']),
                    "{name} {status}"
                );
            }
        }
    }
    /// The schema macro takes no constants, so the schema repeats the ranges.
    #[test]
    fn faults_have_the_ranges_of_the_line() {
        let document = document();
        let schemas = &document["components"]["schemas"];
        let longest = LONGEST_DELAY / Duration::millis(1);
        for (name, schema) in schemas["Faults"]["properties"].as_object().unwrap() {
            let (least, most) = match name.as_str() {
                "delay_ms" => (0, longest),
                "baud" => (u64::from(*BAUDS.start()), u64::from(*BAUDS.end())),
                "exception_code" => (1, u64::from(u8::MAX)),
                _ => (0, 1),
            };
            let number = schema["anyOf"].get(0).unwrap_or(schema);
            assert_eq!((&number["minimum"], &number["maximum"]), (&json!(least), &json!(most)), "{name}");
        }
        for (name, schema) in schemas["Rule"]["properties"].as_object().unwrap() {
            let (least, most) = match name.as_str() {
                "direction" | "drive" | "register" | "before" => continue,
                "ms" | "spread_ms" => (0, longest),
                "count" => (0, u64::from(u32::MAX)),
                "function" => (1, 127),
                "code" => (1, u64::from(u8::MAX)),
                _ => (0, 1),
            };
            assert_eq!((&schema["minimum"], &schema["maximum"]), (&json!(least), &json!(most)), "{name}");
        }
        let outside = |exception_code| LineFaults { exception_code, ..LineFaults::default() }.check();
        assert!(outside(0).is_err() && outside(1).is_ok());
    }
}
