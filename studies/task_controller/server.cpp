// A task controller server of AgIsoStack++ on SocketCAN. It takes every pool, asks for each process data of it that can come by time
// once a second, and prints what it gets.

#include "isobus/hardware_integration/can_hardware_interface.hpp"
#include "isobus/hardware_integration/socket_can_interface.hpp"
#include "isobus/isobus/can_network_manager.hpp"
#include "isobus/isobus/can_stack_logger.hpp"
#include "isobus/isobus/isobus_device_descriptor_object_pool.hpp"
#include "isobus/isobus/isobus_preferred_addresses.hpp"
#include "isobus/isobus/isobus_task_controller_server.hpp"

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <iostream>
#include <mutex>
#include <thread>

namespace
{
	std::atomic_bool running{ true };
	const auto begin = std::chrono::steady_clock::now();

	double seconds()
	{
		return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
	}

	template<typename... Values>
	void say(const char *format, Values... values)
	{
		static std::mutex mutex;
		const std::lock_guard<std::mutex> lock(mutex);
		std::printf("%.3f ", seconds());
		std::printf(format, values...);
		std::printf("\n");
		std::fflush(stdout);
	}

	class Log : public isobus::CANStackLogger
	{
	public:
		void sink_CAN_stack_log(LoggingLevel level, const std::string &text) override
		{
			say("stack %d %s", static_cast<int>(level), text.c_str());
		}
	};

	using Client = std::shared_ptr<isobus::ControlFunction>;

	class Server : public isobus::TaskControllerServer
	{
	public:
		using TaskControllerServer::TaskControllerServer;

		Client active;

		void ask_for_everything()
		{
			isobus::DeviceDescriptorObjectPool objects;
			if (!objects.deserialize_binary_object_pool(pool, active->get_NAME()))
			{
				say("pool cannot be parsed");
				return;
			}
			say("pool parsed objects %u", static_cast<unsigned>(objects.size()));
			for (std::uint16_t index = 0; index < objects.size(); index++)
			{
				auto element = std::dynamic_pointer_cast<isobus::task_controller_object::DeviceElementObject>(objects.get_object_by_index(index));
				if (!element)
				{
					continue;
				}
				for (std::uint16_t child = 0; child < element->get_number_child_objects(); child++)
				{
					using Data = isobus::task_controller_object::DeviceProcessDataObject;
					auto data = std::dynamic_pointer_cast<Data>(objects.get_object_by_id(element->get_child_object_id(child)));
					if (!data)
					{
						continue;
					}
					const bool timed = data->has_trigger_method(Data::AvailableTriggerMethods::TimeInterval);
					say("offered ddi %u element %u by_time %d", data->get_ddi(), element->get_element_number(), timed);
					if (timed)
					{
						send_time_interval_measurement_command(active, data->get_ddi(), element->get_element_number(), 1000);
					}
				}
			}
		}

		bool activate_object_pool(Client client, ObjectPoolActivationError &, ObjectPoolErrorCodes &, std::uint16_t &, std::uint16_t &) override
		{
			say("pool activated by %u", client->get_address());
			active = client;
			return true;
		}
		bool change_designator(Client, std::uint16_t, const std::vector<std::uint8_t> &) override { return true; }
		bool deactivate_object_pool(Client client) override
		{
			say("pool deactivated by %u", client->get_address());
			active.reset();
			return true;
		}
		bool delete_device_descriptor_object_pool(Client, ObjectPoolDeletionErrors &) override
		{
			pool.clear();
			return true;
		}
		bool get_is_stored_device_descriptor_object_pool_by_structure_label(Client, const std::vector<std::uint8_t> &, const std::vector<std::uint8_t> &) override
		{
			return false;
		}
		bool get_is_stored_device_descriptor_object_pool_by_localization_label(Client, const std::array<std::uint8_t, 7> &) override
		{
			return false;
		}
		bool get_is_enough_memory_available(std::uint32_t bytes) override
		{
			say("pool announced bytes %u", static_cast<unsigned>(bytes));
			return true;
		}
		void identify_task_controller(std::uint8_t) override {}
		void on_client_timeout(Client client) override
		{
			say("client timeout %u", client->get_address());
			active.reset();
		}
		void on_process_data_acknowledge(Client, std::uint16_t ddi, std::uint16_t element, std::uint8_t error, ProcessDataCommands) override
		{
			say("acknowledge ddi %u element %u error %u", ddi, element, error);
		}
		void on_client_version_received(Client client, std::uint8_t version) override
		{
			say("client %u version %u", client->get_address(), version);
		}
		bool on_value_command(Client, std::uint16_t ddi, std::uint16_t element, std::int32_t value, std::uint8_t &) override
		{
			say("value ddi %u element %u value %d", ddi, element, value);
			return true;
		}
		bool store_device_descriptor_object_pool(Client, const std::vector<std::uint8_t> &bytes, bool append) override
		{
			say("pool stored bytes %u append %d", static_cast<unsigned>(bytes.size()), append);
			if (!append)
			{
				pool.clear();
			}
			pool.insert(pool.end(), bytes.begin(), bytes.end());
			return true;
		}

	private:
		std::vector<std::uint8_t> pool;
	};
}

int main(int count, char **arguments)
{
	if (count != 2)
	{
		std::fprintf(stderr, "usage: server CHANNEL\n");
		return 2;
	}
	std::signal(SIGTERM, [](int) { running = false; });
	std::signal(SIGINT, [](int) { running = false; });
	static Log log;
	isobus::CANStackLogger::set_can_stack_logger_sink(&log);
	isobus::CANStackLogger::set_log_level(isobus::CANStackLogger::LoggingLevel::Info);
	auto driver = std::make_shared<isobus::SocketCANInterface>(arguments[1]);
	isobus::CANHardwareInterface::set_number_of_can_channels(1);
	isobus::CANHardwareInterface::assign_can_channel_frame_handler(0, driver);
	if (!isobus::CANHardwareInterface::start() || !driver->get_is_valid())
	{
		std::fprintf(stderr, "%s cannot be used\n", arguments[1]);
		return 1;
	}
	isobus::NAME name(0);
	name.set_arbitrary_address_capable(true);
	name.set_industry_group(2);
	name.set_function_code(static_cast<std::uint8_t>(isobus::NAME::Function::TaskController));
	name.set_identity_number(7);
	name.set_manufacturer_code(1407);
	auto own = isobus::CANNetworkManager::CANNetwork.create_internal_control_function(
	  name, 0, isobus::preferred_addresses::IndustryGroup2::TaskController_MappingComputer);
	Server server(own, 1, 0, 0, isobus::TaskControllerOptions().with_documentation());
	server.initialize();
	server.set_task_totals_active(true);
	bool asked = false;
	double activated = 0.0;
	while (running)
	{
		server.update();
		if (!server.active)
		{
			asked = false;
			activated = seconds();
		}
		else if (!asked && seconds() - activated > 1.0)
		{
			asked = true;
			server.ask_for_everything();
		}
		std::this_thread::sleep_for(std::chrono::milliseconds(10));
	}
	server.terminate();
	isobus::CANHardwareInterface::stop();
	return 0;
}
